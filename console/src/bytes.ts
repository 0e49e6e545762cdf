// Bytes, and how people read numbers and times.

// Bytes that WebCrypto takes.
export type Bytes = Uint8Array<ArrayBuffer>;

export const utf8 = (text: string): Bytes => new TextEncoder().encode(text) as Bytes;
export const text = (bytes: Uint8Array): string => new TextDecoder().decode(bytes);
export const own = (bytes: Uint8Array): Bytes => Uint8Array.from(bytes);

export function concat(...parts: Uint8Array[]): Bytes {
  const all = new Uint8Array(parts.reduce((sum, part) => sum + part.length, 0));
  let at = 0;
  for (const part of parts) {
    all.set(part, at);
    at += part.length;
  }
  return all;
}

export const hex = (bytes: Uint8Array): string => Array.from(bytes, (byte) => byte.toString(16).padStart(2, "0")).join("");

export function unhex(digits: string): Bytes {
  if (!/^([0-9a-f]{2})*$/i.test(digits)) throw new Error(`not hexadecimal: ${digits}`);
  return Uint8Array.from(digits.match(/../g) ?? [], (pair) => parseInt(pair, 16));
}

export const same = (one: Uint8Array, other: Uint8Array): boolean =>
  one.length === other.length && one.every((byte, at) => byte === other[at]);

export function u32(number: number): Bytes {
  const bytes = new Uint8Array(4);
  new DataView(bytes.buffer).setUint32(0, number);
  return bytes;
}

// The bytes with their length before them.
export const part = (bytes: Uint8Array): Bytes => concat(u32(bytes.length), bytes);

export const sha256 = async (...parts: Uint8Array[]): Promise<Bytes> =>
  new Uint8Array(await crypto.subtle.digest("SHA-256", concat(...parts)));

// The rest of a buffer, read from the front; throws where it ends too early.
export class Reader {
  private at = 0;
  constructor(private readonly bytes: Bytes) {}

  take(length: number): Bytes {
    if (this.at + length > this.bytes.length) throw new Error("the bytes end too early");
    this.at += length;
    return this.bytes.slice(this.at - length, this.at);
  }

  u8 = (): number => this.take(1)[0]!;
  u32 = (): number => new DataView(this.take(4).buffer).getUint32(0);
  u64 = (): bigint => new DataView(this.take(8).buffer).getBigUint64(0);
  part = (): Bytes => this.take(this.u32());

  expect(prefix: Uint8Array): void {
    if (!same(this.take(prefix.length), prefix)) throw new Error("the bytes begin otherwise");
  }

  end(): void {
    if (this.at !== this.bytes.length) throw new Error("bytes stand behind the end");
  }

  done = (): boolean => this.at === this.bytes.length;
}

// Times are microseconds since the UNIX epoch.
export const clock = (us: bigint | number): string =>
  new Date(Number(us) / 1000).toLocaleTimeString(undefined, { hour12: false });

export const moment = (us: bigint | number): string =>
  new Date(Number(us) / 1000).toISOString().replace("T", " ").replace(/\.\d+Z$/, " UTC");

// A span in microseconds, in one or two words.
export function span(us: bigint | number): string {
  const seconds = Math.max(0, Number(us) / 1e6);
  if (seconds < 10) return `${seconds.toFixed(1)} s`;
  if (seconds < 120) return `${Math.round(seconds)} s`;
  if (seconds < 7200) return `${Math.round(seconds / 60)} min`;
  if (seconds < 172800) return `${Math.round(seconds / 3600)} h`;
  return `${Math.round(seconds / 86400)} days`;
}

export function size(bytes: bigint | number): string {
  const units = ["B", "KiB", "MiB", "GiB", "TiB"];
  let value = Number(bytes);
  let unit = 0;
  while (value >= 1024 && unit < units.length - 1) {
    value /= 1024;
    unit += 1;
  }
  return `${value < 10 && unit > 0 ? value.toFixed(1) : Math.round(value)} ${units[unit]}`;
}
