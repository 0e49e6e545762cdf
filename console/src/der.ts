// As much of DER as a signing request, a signature of P-256 and the key in a certificate need.

import { type Bytes, concat, utf8 } from "./bytes";

const SEQUENCE = 0x30;
const SET = 0x31;
const INTEGER = 0x02;
const BIT_STRING = 0x03;
const OID = 0x06;
const UTF8_STRING = 0x0c;
const ATTRIBUTES = 0xa0;

// id-at-commonName and ecdsa-with-SHA256.
const COMMON_NAME = [0x55, 0x04, 0x03];
const ECDSA_SHA256 = [0x2a, 0x86, 0x48, 0xce, 0x3d, 0x04, 0x03, 0x02];

// The order of the group of P-256. A signature with s above its half has a twin with a small s: only that is taken.
const ORDER = 0xffffffff00000000ffffffffffffffffbce6faada7179e84f3b9cac2fc632551n;

function element(tag: number, ...contents: Uint8Array[]): Bytes {
  const content = concat(...contents);
  const length = content.length;
  const head = length < 0x80 ? [length] : length < 0x100 ? [0x81, length] : [0x82, length >> 8, length & 0xff];
  return concat(Uint8Array.from([tag, ...head]), content);
}

function integer(value: bigint): Bytes {
  let digits = value.toString(16);
  if (digits.length % 2) digits = `0${digits}`;
  const bytes = (digits.match(/../g) ?? []).map((pair) => parseInt(pair, 16));
  if (bytes[0]! >= 0x80) bytes.unshift(0);
  return element(INTEGER, Uint8Array.from(bytes));
}

const number = (bytes: Uint8Array): bigint => bytes.reduce((sum, byte) => (sum << 8n) | BigInt(byte), 0n);

// A signature of WebCrypto (r and s, 32 bytes each) in the one form that the ledger takes.
export function signature(raw: Uint8Array): Bytes {
  const r = number(raw.subarray(0, 32));
  const s = number(raw.subarray(32, 64));
  return element(SEQUENCE, integer(r), integer(s > ORDER / 2n ? ORDER - s : s));
}

// A request for a certificate (PKCS #10), signed by `sign`.
export async function signingRequest(name: string, spki: Uint8Array, sign: (bytes: Bytes) => Promise<Bytes>): Promise<Bytes> {
  const subject = element(
    SEQUENCE,
    element(SET, element(SEQUENCE, element(OID, Uint8Array.from(COMMON_NAME)), element(UTF8_STRING, utf8(name)))),
  );
  const info = element(SEQUENCE, integer(0n), subject, spki, element(ATTRIBUTES));
  const algorithm = element(SEQUENCE, element(OID, Uint8Array.from(ECDSA_SHA256)));
  return element(SEQUENCE, info, algorithm, element(BIT_STRING, Uint8Array.of(0), await sign(info)));
}

interface Element {
  tag: number;
  whole: Bytes;
  content: Bytes;
}

// The elements that stand one behind the other.
function elements(bytes: Bytes): Element[] {
  const found: Element[] = [];
  let at = 0;
  while (at < bytes.length) {
    const tag = bytes[at]!;
    let length = bytes[at + 1]!;
    let head = 2;
    if (length & 0x80) {
      const count = length & 0x7f;
      if (count > 3) throw new Error("an element is too long");
      length = 0;
      for (let digit = 0; digit < count; digit += 1) length = length * 256 + bytes[at + 2 + digit]!;
      head += count;
    }
    const end = at + head + length;
    if (!(end <= bytes.length)) throw new Error("an element ends too late");
    found.push({ tag, whole: bytes.slice(at, end), content: bytes.slice(at + head, end) });
    at = end;
  }
  return found;
}

const inside = (bytes: Bytes): Element[] => elements(elements(bytes)[0]!.content);

// The parts of a certificate that people read, and its key.
export interface Certificate {
  spki: Bytes;
  isP256: boolean;
  commonName: string;
  organisation: string;
  notAfter: number;
}

export function certificate(der: Bytes): Certificate {
  const fields = elements(inside(der)[0]!.content).filter((field) => field.tag !== 0xa0);
  const [, , , validity, subject, key] = fields;
  const names = elements(subject!.content).map((set) => elements(elements(set.content)[0]!.content));
  const named = (last: number): string => {
    const found = names.find(([oid]) => oid!.content.length === 3 && oid!.content[2] === last);
    return found ? new TextDecoder().decode(found[1]!.content) : "";
  };
  return {
    spki: key!.whole,
    isP256: key!.whole.length === 91,
    commonName: named(3),
    organisation: named(10),
    notAfter: time(elements(validity!.content)[1]!),
  };
}

// UTCTime or GeneralizedTime, in microseconds.
function time({ tag, content }: Element): number {
  let digits = new TextDecoder().decode(content);
  if (tag === 0x17) digits = (Number(digits.slice(0, 2)) < 50 ? "20" : "19") + digits;
  const [, year, month, day, hour, minute, second] = /^(\d{4})(\d\d)(\d\d)(\d\d)(\d\d)(\d\d)Z$/.exec(digits) ?? [];
  return Date.UTC(Number(year), Number(month) - 1, Number(day), Number(hour), Number(minute), Number(second)) * 1000;
}

// A signature of P-256 as WebCrypto wants it.
export function rawSignature(der: Bytes): Bytes {
  const numbers = inside(der).map((part) => part.content);
  const fixed = (bytes: Bytes): Bytes => {
    const digits = bytes[0] === 0 ? bytes.slice(1) : bytes;
    return concat(new Uint8Array(32 - digits.length), digits);
  };
  return concat(fixed(numbers[0]!), fixed(numbers[1]!));
}
