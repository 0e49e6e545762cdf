// The words for payloads of messages: node tests/payload.mjs
import assert from "node:assert/strict";
import { shown } from "../data/payload.js";

const HEADER = 4;
// A Twist with these headers that moves forwards and turns.
function twist(first, order) {
  const bytes = new Uint8Array(HEADER + 6 * 8);
  bytes.set([first, order]);
  const view = new DataView(bytes.buffer, HEADER);
  view.setFloat64(0, 0.5, order === 1);
  view.setFloat64(5 * 8, -1.25, order === 1);
  return bytes;
}

for (const order of [0, 1]) assert.equal(shown(twist(0, order), true), "linear.x 0.5  angular.z -1.25");
assert.equal(shown(new Uint8Array(52), true), "stands still (all zero)");
// The same bytes are no Twist where the service has another type, or the header is of another encoding.
for (const [payload, isTwist] of [[twist(0, 1), false], [twist(0, 2), true], [twist(1, 1), true], [twist(0, 1).slice(0, 51), true]]) {
  assert.match(shown(payload, isTwist), /^[0-9a-f]{64}$/);
}
assert.equal(shown(new Uint8Array(0), true), "");
// No number of an envelope is shown, however long it is and whatever the type is.
for (const isTwist of [true, false]) assert.equal(shown(twist(0xe5, 1), isTwist), "encrypted");
