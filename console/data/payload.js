// The payload of a message in words, as far as the console can read it.

import { hex } from "./bytes.js";

const TWIST = ["linear.x", "linear.y", "linear.z", "angular.x", "angular.y", "angular.z"];
const HEADER_BYTES = 4;
const NUMBER_BYTES = 8;
const SHOWN_BYTES = 32;

/** An envelope of a confidential service: docs/format.md. No CDR begins so. @param {Uint8Array} payload */
const isSealed = (payload) => payload[0] === 0xe5 && payload[1] === 1;

/** Plain CDR: after a zero comes the byte order, 0 for big endian and 1 for little endian. @param {Uint8Array} payload */
const isPlain = (payload) => payload[0] === 0 && (payload[1] === 0 || payload[1] === 1);

/**
 * @param {Uint8Array} payload
 * @param {boolean} isTwist
 */
export function shown(payload, isTwist) {
  if (isSealed(payload)) return "encrypted";
  if (isTwist && isPlain(payload) && payload.length >= HEADER_BYTES + TWIST.length * NUMBER_BYTES) return twist(payload);
  return hex(payload.slice(0, SHOWN_BYTES));
}

/** The parts of a Twist that are not zero. @param {Uint8Array} payload */
function twist(payload) {
  const view = new DataView(payload.buffer, payload.byteOffset + HEADER_BYTES);
  const isLittle = payload[1] === 1;
  const values = TWIST.map((name, at) => /** @type {const} */ ([name, view.getFloat64(at * NUMBER_BYTES, isLittle)]));
  const moving = values.filter(([, value]) => value !== 0);
  return moving.length ? moving.map(([name, value]) => `${name} ${Number(value.toFixed(3))}`).join("  ") : "stands still (all zero)";
}
