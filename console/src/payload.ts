// The payload of a message in words, as far as the console can read it.

import { hex } from "./bytes";

const TWIST = ["linear.x", "linear.y", "linear.z", "angular.x", "angular.y", "angular.z"];
const HEADER_BYTES = 4;
const NUMBER_BYTES = 8;
const SHOWN_BYTES = 32;

// An envelope of a confidential service: docs/format.md. No CDR begins so.
const isSealed = (payload: Uint8Array): boolean => payload[0] === 0xe5 && payload[1] === 1;

// Plain CDR: behind a zero stands the byte order, 0 for big endian and 1 for little endian.
const isPlain = (payload: Uint8Array): boolean => payload[0] === 0 && payload[1]! <= 1;

export function shown(payload: Uint8Array, isTwist: boolean): string {
  if (isSealed(payload)) return "encrypted";
  if (isTwist && isPlain(payload) && payload.length >= HEADER_BYTES + TWIST.length * NUMBER_BYTES) return twist(payload);
  return hex(payload.slice(0, SHOWN_BYTES));
}

// The parts of a Twist that are not zero.
function twist(payload: Uint8Array): string {
  const view = new DataView(payload.buffer, payload.byteOffset + HEADER_BYTES);
  const isLittle = payload[1] === 1;
  const values = TWIST.map((name, at) => [name, view.getFloat64(at * NUMBER_BYTES, isLittle)] as const);
  const moving = values.filter(([, value]) => value !== 0);
  return moving.length ? moving.map(([name, value]) => `${name} ${Number(value.toFixed(3))}`).join("  ") : "stands still (all zero)";
}
