// Addresses of pages: node tests/route.mjs
import assert from "node:assert/strict";
import { partsOf } from "../data/route.js";

assert.deepEqual(partsOf("#/robots/Rover%2Fcmd_vel"), ["robots", "Rover/cmd_vel"]);
assert.deepEqual(partsOf(""), []);
// No address leads to an error: a broken one leads to the start page.
for (const broken of ["#/%", "#/%zz", "#/robots/%ED%A0%80", "#/enrol/%/name/secret"]) assert.deepEqual(partsOf(broken), []);
