// A transaction as it is signed (crates/api/proto/ledgerd/v1/transaction.proto): the few kinds of fields of protobuf that it has,
// byte for byte as every other encoder writes them.

import { concat, utf8 } from "./bytes.js";

/** @typedef {import("./bytes.js").Bytes} Bytes */

const VARINT = 0;
const BYTES = 2;

/** The begin of what is signed: it, then the body. */
export const PREFIX = utf8("ledgerd transaction v1\0");

/** @param {bigint} value @returns {Bytes} */
function varint(value) {
  const bytes = [];
  for (; value > 0x7fn; value >>= 7n) bytes.push(Number(value & 0x7fn) | 0x80);
  bytes.push(Number(value));
  return Uint8Array.from(bytes);
}

/** @param {number} number @param {number} kind */
const key = (number, kind) => varint(BigInt((number << 3) | kind));

/** An element of a list, which is there also when it is empty. @param {number} number @param {Uint8Array} bytes */
const element = (number, bytes) => concat(key(number, BYTES), varint(BigInt(bytes.length)), bytes);

/** A field, which is left out when it is empty. @param {number} number @param {Uint8Array} bytes */
const field = (number, bytes) => (bytes.length ? element(number, bytes) : new Uint8Array());

/**
 * The signed part. `notAfter` is in microseconds since the UNIX epoch.
 * @param {{ network: Uint8Array, creator: Uint8Array, nonce: Uint8Array, notAfter: bigint, chaincode: string, function: string, args: Uint8Array[] }} body
 * @returns {Bytes}
 */
export function encodeBody(body) {
  return concat(
    field(1, body.network),
    field(2, body.creator),
    field(3, body.nonce),
    body.notAfter ? concat(key(4, VARINT), varint(body.notAfter)) : new Uint8Array(),
    field(5, utf8(body.chaincode)),
    field(6, utf8(body.function)),
    ...body.args.map((arg) => element(7, arg)),
  );
}

/**
 * @param {{ body: Uint8Array, signature: Uint8Array, certificate: Uint8Array }} transaction
 * @returns {Bytes}
 */
export const encodeTransaction = ({ body, signature, certificate }) => concat(field(1, body), field(2, signature), field(3, certificate));

/**
 * The fields of bytes of a message by number; throws for any other kind of field than those above.
 * @param {Bytes} message
 * @returns {Map<number, Bytes>}
 */
export function fields(message) {
  let at = 0;
  const read = () => {
    let value = 0n;
    for (let shift = 0n; shift < 64n; shift += 7n) {
      const byte = message[at++];
      if (byte === undefined) break;
      value |= BigInt(byte & 0x7f) << shift;
      if (byte < 0x80) return value;
    }
    throw new Error("a number ends too late");
  };
  const found = new Map();
  while (at < message.length) {
    const head = Number(read());
    const value = read();
    if ((head & 7) === VARINT) continue;
    if ((head & 7) !== BYTES || value > BigInt(message.length - at)) throw new Error("the message cannot be read");
    found.set(head >> 3, message.slice(at, at + Number(value)));
    at += Number(value);
  }
  return found;
}
