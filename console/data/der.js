// The part of DER that a signing request, a signature of P-256 and the key in a certificate need.

import { concat, utf8 } from "./bytes.js";

/** @typedef {import("./bytes.js").Bytes} Bytes */

const SEQUENCE = 0x30;
const SET = 0x31;
const INTEGER = 0x02;
const BIT_STRING = 0x03;
const OID = 0x06;
const UTF8_STRING = 0x0c;
const ATTRIBUTES = 0xa0;
const UTC_TIME = 0x17;

// id-at-commonName and ecdsa-with-SHA256.
const COMMON_NAME = [0x55, 0x04, 0x03];
const ECDSA_SHA256 = [0x2a, 0x86, 0x48, 0xce, 0x3d, 0x04, 0x03, 0x02];
// The last byte of id-at-commonName and of id-at-organizationName.
const LAST_OF_COMMON_NAME = 3;
const LAST_OF_ORGANISATION = 10;
const SPKI_OF_P256_BYTES = 91;

// The order of the group of P-256. A signature with s above its half has a twin with a small s: only that is accepted.
const ORDER = 0xffffffff00000000ffffffffffffffffbce6faada7179e84f3b9cac2fc632551n;

/**
 * @param {number} tag
 * @param {...Uint8Array} contents
 */
function element(tag, ...contents) {
  const content = concat(...contents);
  const length = content.length;
  const head = length < 0x80 ? [length] : length < 0x100 ? [0x81, length] : [0x82, length >> 8, length & 0xff];
  return concat(Uint8Array.from([tag, ...head]), content);
}

/** @param {bigint} value */
function integer(value) {
  let digits = value.toString(16);
  if (digits.length % 2) digits = `0${digits}`;
  const bytes = (digits.match(/../g) ?? []).map((pair) => parseInt(pair, 16));
  if ((bytes[0] ?? 0) >= 0x80) bytes.unshift(0);
  return element(INTEGER, Uint8Array.from(bytes));
}

/** @param {Uint8Array} bytes */
const number = (bytes) => bytes.reduce((sum, byte) => (sum << 8n) | BigInt(byte), 0n);

/** A signature of WebCrypto (r and s, 32 bytes each) in the one form that the ledger accepts. @param {Uint8Array} raw */
export function signature(raw) {
  const r = number(raw.subarray(0, 32));
  const s = number(raw.subarray(32, 64));
  return element(SEQUENCE, integer(r), integer(s > ORDER / 2n ? ORDER - s : s));
}

/**
 * A request for a certificate (PKCS #10), signed by `sign`.
 * @param {string} name
 * @param {Uint8Array} spki
 * @param {(bytes: Bytes) => Promise<Bytes>} sign
 */
export async function signingRequest(name, spki, sign) {
  const commonName = element(SEQUENCE, element(OID, Uint8Array.from(COMMON_NAME)), element(UTF8_STRING, utf8(name)));
  const subject = element(SEQUENCE, element(SET, commonName));
  const info = element(SEQUENCE, integer(0n), subject, spki, element(ATTRIBUTES));
  const algorithm = element(SEQUENCE, element(OID, Uint8Array.from(ECDSA_SHA256)));
  return element(SEQUENCE, info, algorithm, element(BIT_STRING, Uint8Array.of(0), await sign(info)));
}

/** @typedef {{ tag: number, whole: Bytes, content: Bytes }} Element */

/** The elements that follow each other. @param {Bytes} bytes */
function elements(bytes) {
  /** @type {Element[]} */
  const found = [];
  const byte = (/** @type {number} */ at) => bytes[at] ?? 0;
  let at = 0;
  while (at < bytes.length) {
    let length = byte(at + 1);
    let head = 2;
    if (length & 0x80) {
      const count = length & 0x7f;
      if (count > 3) throw new Error("an element is too long");
      length = 0;
      for (let digit = 0; digit < count; digit += 1) length = length * 256 + byte(at + 2 + digit);
      head += count;
    }
    const end = at + head + length;
    if (end > bytes.length) throw new Error("an element ends too late");
    found.push({ tag: byte(at), whole: bytes.slice(at, end), content: bytes.slice(at + head, end) });
    at = end;
  }
  return found;
}

/**
 * The element at this position.
 * @param {Element[]} all
 * @param {number} at
 */
function nth(all, at) {
  const found = all[at];
  if (!found) throw new Error("an element is missing");
  return found;
}

/** @param {Bytes} bytes */
const inside = (bytes) => elements(nth(elements(bytes), 0).content);

/**
 * The parts of a certificate that people read, and its key.
 * @param {Bytes} der
 */
export function certificate(der) {
  const fields = elements(nth(inside(der), 0).content).filter((field) => field.tag !== ATTRIBUTES);
  const [validity, subject, key] = [3, 4, 5].map((at) => nth(fields, at));
  if (!validity || !subject || !key) throw new Error("a field is missing");
  const names = elements(subject.content).map((set) => inside(set.content));
  const named = (/** @type {number} */ last) => {
    const found = names.find((pair) => nth(pair, 0).content.length === 3 && nth(pair, 0).content[2] === last);
    return found ? new TextDecoder().decode(nth(found, 1).content) : "";
  };
  return {
    spki: key.whole,
    isP256: key.whole.length === SPKI_OF_P256_BYTES,
    commonName: named(LAST_OF_COMMON_NAME),
    organisation: named(LAST_OF_ORGANISATION),
    notAfter: time(nth(elements(validity.content), 1)),
  };
}

/** UTCTime or GeneralizedTime, in microseconds. @param {Element} element */
function time({ tag, content }) {
  let digits = new TextDecoder().decode(content);
  if (tag === UTC_TIME) digits = (Number(digits.slice(0, 2)) < 50 ? "20" : "19") + digits;
  const parts = /^(\d{4})(\d\d)(\d\d)(\d\d)(\d\d)(\d\d)Z$/.exec(digits)?.slice(1).map(Number);
  const [year = NaN, month = 0, day = 0, hour = 0, minute = 0, second = 0] = parts ?? [];
  return Date.UTC(year, month - 1, day, hour, minute, second) * 1000;
}

/** A signature of P-256 as WebCrypto takes it. @param {Bytes} der */
export function rawSignature(der) {
  const numbers = inside(der);
  const fixed = (/** @type {Bytes} */ bytes) => {
    const digits = bytes[0] === 0 ? bytes.slice(1) : bytes;
    return concat(new Uint8Array(32 - digits.length), digits);
  };
  return concat(fixed(nth(numbers, 0).content), fixed(nth(numbers, 1).content));
}
