// Reads the link of evidence that a node gives for a transaction (docs/format.md, "Evidence"), and checks all of it that needs no
// history: the signatures, the Merkle paths, and the headers between the transaction and the certified block.

import { concat, hex, same, sha256, u64, utf8 } from "./bytes.js";
import { certificate, rawSignature } from "./der.js";
import { PREFIX, fields } from "./transaction.js";

/**
 * @typedef {import("./bytes.js").Bytes} Bytes
 * @typedef {{ what: string, holds: boolean, detail: string }} Check
 * @typedef {{ signers: string[], checks: Check[] }} Proof
 * @typedef {{ index: number, leaves: number, hashes: Bytes[] }} Path
 */

/** The rest of a buffer, read from the front; throws where it ends too early. */
class Reader {
  #at = 0;
  /** @param {Bytes} bytes */
  constructor(bytes) {
    this.bytes = bytes;
  }

  /** @param {number} length */
  take(length) {
    if (this.#at + length > this.bytes.length) throw new Error("the bytes end too early");
    this.#at += length;
    return this.bytes.slice(this.#at - length, this.#at);
  }

  u8() {
    return new DataView(this.take(1).buffer).getUint8(0);
  }

  u32() {
    return new DataView(this.take(4).buffer).getUint32(0);
  }

  u64() {
    return new DataView(this.take(8).buffer).getBigUint64(0);
  }

  part() {
    return this.take(this.u32());
  }

  /** @param {string} prefix */
  expect(prefix) {
    const wanted = utf8(prefix);
    if (!same(this.take(wanted.length), wanted)) throw new Error("the bytes begin otherwise");
  }

  end() {
    if (this.#at !== this.bytes.length) throw new Error("there are bytes after the end");
  }
}

/**
 * As many as are announced; more than the bytes can hold fail to be read.
 * @template T
 * @param {number} count
 * @param {() => T} read
 */
function times(count, read) {
  const found = [];
  for (let each = 0; each < count; each += 1) found.push(read());
  return found;
}

/** @param {Reader} reader @returns {Path} */
function path(reader) {
  const [index, leaves] = [reader.u32(), reader.u32()];
  return { index, leaves, hashes: times(reader.u8(), () => reader.take(32)) };
}

/**
 * The root to which a path leads from this leaf.
 * @param {Path} path
 * @param {Bytes} leaf
 */
async function root({ index, leaves, hashes }, leaf) {
  let own = leaf;
  const left = [...hashes];
  const next = () => {
    const hash = left.shift();
    if (!hash) throw new Error("the path is too short");
    return hash;
  };
  for (let at = index, last = leaves - 1; last > 0; at = Math.floor(at / 2), last = Math.floor(last / 2)) {
    if (at % 2 === 1) own = await sha256(Uint8Array.of(1), next(), own);
    else if (at < last) own = await sha256(Uint8Array.of(1), own, next());
  }
  if (left.length) throw new Error("the path is too long");
  return own;
}

/**
 * Is it a signature of the key in this certificate? Undefined where the browser does not support the kind of key.
 * @param {Bytes} der
 * @param {Bytes} message
 * @param {Bytes} signature
 */
async function isSigned(der, message, signature) {
  const { spki, isP256 } = certificate(der);
  try {
    if (isP256) {
      const key = await crypto.subtle.importKey("spki", spki, { name: "ECDSA", namedCurve: "P-256" }, false, ["verify"]);
      return await crypto.subtle.verify({ name: "ECDSA", hash: "SHA-256" }, key, rawSignature(signature), message);
    }
    const key = await crypto.subtle.importKey("spki", spki, { name: "Ed25519" }, false, ["verify"]);
    return await crypto.subtle.verify({ name: "Ed25519" }, key, signature, message);
  } catch {
    return undefined;
  }
}

/** @param {boolean | undefined} is */
const outcome = (is) => (is === undefined ? "this browser cannot check this kind of key" : is ? "" : "the signature is not valid");

/**
 * @param {Bytes} link
 * @returns {Promise<Proof>}
 */
export async function examine(link) {
  const reader = new Reader(link);
  reader.expect("ledgerd evidence link v1\0");
  const encoded = reader.part();
  const author = reader.part();
  const transactionPath = path(new Reader(reader.part()));
  const height = reader.u64();
  const previous = reader.take(32);
  const headers = times(reader.u32(), () => ({ term: reader.take(8), time: reader.take(8), root: reader.take(32) }));
  const [digestBefore, writes, verdict] = [reader.take(32), reader.take(32), reader.part()];
  const verdictPath = path(new Reader(reader.part()));
  const later = times(reader.u32(), () => reader.take(32));
  const proof = new Reader(reader.part());
  reader.end();

  /** @type {Check[]} */
  const checks = [];
  const check = (/** @type {string} */ what, /** @type {boolean} */ holds, detail = "") => void checks.push({ what, holds, detail });

  const none = new Uint8Array();
  const transaction = fields(encoded);
  const bytes = transaction.get(1) ?? none;
  const body = fields(bytes);
  const creator = certificate(author);
  check("The transaction names the certificate of its author", same(body.get(2) ?? none, await sha256(author)), `${creator.organisation}/${creator.commonName}`);
  const signed = await isSigned(author, concat(PREFIX, bytes), transaction.get(2) ?? none);
  check("Its author has signed it", signed === true, outcome(signed));
  const inBlock = await root(transactionPath, await sha256(Uint8Array.of(0), encoded));
  check("It is in its block", headers[0] !== undefined && same(inBlock, headers[0].root), `position ${transactionPath.index} of ${transactionPath.leaves}`);

  let [hash, at] = [previous, height];
  for (const header of headers) {
    hash = await sha256(utf8("ledgerd block v1\0"), u64(at), header.term, header.time, hash, header.root);
    at += 1n;
  }
  const certified = at - 1n;

  proof.expect("ledgerd proof v1\0");
  const certificates = new Reader(proof.part());
  certificates.expect("ledgerd certificate v1\0");
  const prefix = "ledgerd statement v1\0";
  const statement = certificates.take(prefix.length + 32 + 8 + 8 + 8 + 32 + 32);
  const stated = new Reader(statement);
  stated.expect(prefix);
  const network = stated.take(32);
  // The number of forced recoveries, and behind the height the block time.
  stated.u64();
  const statedHeight = stated.u64();
  stated.u64();
  const statedHash = stated.take(32);
  const results = stated.take(32);
  check("It is of the same network", same(network, body.get(1) ?? none), hex(network).slice(0, 16));
  check("The headers lead to the certified block", statedHeight === certified && same(statedHash, hash), `block ${certified}, ${headers.length} header(s)`);

  /** @type {string[]} */
  const signers = [];
  for (let left = certificates.u32(); left > 0; left -= 1) {
    const node = certificates.u64();
    const der = certificates.part();
    const { organisation, commonName } = certificate(der);
    const valid = await isSigned(der, concat(statement, u64(node)), certificates.part());
    check(`${organisation}/${commonName} has signed the results of the block`, valid === true, outcome(valid));
    if (valid) signers.push(`${organisation}/${commonName}`);
  }

  const verdicts = await root(verdictPath, await sha256(Uint8Array.of(0), verdict));
  let digest = digestBefore;
  for (const effects of [await sha256(utf8("ledgerd effects v1\0"), writes, verdicts), ...later]) {
    digest = await sha256(utf8("ledgerd state v1\0"), digest, effects);
  }
  const told = new Reader(verdict);
  told.expect("ledgerd fact v1\0");
  const [kind, position, id, code] = [told.u8(), told.u32(), told.take(32), told.u32()];
  const isOwn = kind === 2 && position === transactionPath.index && verdictPath.index === position && same(id, await sha256(bytes));

  for (let left = proof.u32(), first = true; left > 0; left -= 1, first = false) {
    const fact = proof.part();
    if (first) {
      const leadsThere = later.length + 1 === headers.length && same(digest, groundDigest(fact));
      check("Its verdict leads to the signed state digest", isOwn && leadsThere, code === 0 ? "executed" : `LGR-${String(code).padStart(4, "0")}`);
    }
    const leads = await root(path(new Reader(proof.part())), await sha256(Uint8Array.of(0), fact));
    check("A fact is one of the signed results", same(leads, results), factOf(fact));
  }
  return { signers, checks };
}

/**
 * The state digest of a ground: behind its kind, the governing chain and the control chain.
 * @param {Bytes} fact
 */
function groundDigest(fact) {
  const ground = new Reader(fact);
  ground.expect("ledgerd fact v1\0");
  const kind = ground.u8();
  ground.take(64);
  return kind === 1 ? ground.take(32) : new Uint8Array();
}

const FACTS = ["", "the ground: chains, state digest", "a verdict", "an event", "a control write"];

/** @param {Bytes} fact */
const factOf = (fact) => FACTS[fact["ledgerd fact v1\0".length] ?? 0] ?? "";
