// Times are those of the reader's zone: TZ=Asia/Tokyo node tests/times.mjs
import assert from "node:assert/strict";
import { clock, day, utc } from "../data/bytes.js";

const at = Date.UTC(2026, 10, 28, 16, 5, 9, 250) * 1000;
assert.equal(`${day(at)} ${clock(at)}`, "2026-11-29 01:05:09");
assert.equal(utc(at), "2026-11-28 16:05:09.250 UTC");
