// The terms of a share as they are typed, and as the ledger takes them: TZ=Asia/Tokyo node tests/access.mjs
import assert from "node:assert/strict";
import { given } from "../pages/access.js";

assert.deepEqual(given({ with: " Org1 " }, "Rover"), { resource: "Rover", with: "Org1" });
assert.deepEqual(
  given({ resource: "Rover/cmd_vel", with: "Org1/Salma", attribute: "guest", from: "2026-11-29T01:05", begins: "08:00", closes: "18:00", max_linear: "0.3", read_only: "yes", priority: "" }, "Rover"),
  {
    resource: "Rover/cmd_vel",
    with: "Org1/Salma",
    attribute: "guest=true",
    from: Date.UTC(2026, 10, 28, 16, 5) * 1000,
    hours: "08:00-18:00 +09:00",
    read_only: true,
    max_linear: "0.3",
  },
);
assert.equal(given({ with: "Org1", attribute: "level=3" }, "Rover").attribute, "level=3");
