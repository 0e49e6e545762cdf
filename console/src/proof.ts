// Reads the link of evidence that a node gives for a transaction (docs/format.md, "Evidence"), and checks all of it that needs no
// history: the signatures, the Merkle paths, and the headers between the transaction and the certified block.

import { fromBinary } from "@bufbuild/protobuf";
import { TransactionBodySchema, TransactionSchema } from "./gen/ledgerd/v1/transaction_pb";
import { type Bytes, Reader, concat, hex, own, same, sha256, utf8 } from "./bytes";
import { certificate, rawSignature } from "./der";

export interface Check {
  what: string;
  holds: boolean;
  detail: string;
}

export interface Proof {
  bytes: number;
  height: bigint;
  certified: bigint;
  headers: number;
  signers: string[];
  checks: Check[];
}

interface Path {
  index: number;
  leaves: number;
  hashes: Bytes[];
}

function path(reader: Reader): Path {
  const index = reader.u32();
  const leaves = reader.u32();
  return { index, leaves, hashes: Array.from({ length: reader.u8() }, () => reader.take(32)) };
}

// The root to which a path leads from this leaf.
async function root({ index, leaves, hashes }: Path, leaf: Bytes): Promise<Bytes> {
  let own = leaf;
  const left = [...hashes];
  const next = (): Bytes => {
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

// Is it a signature of the key in this certificate? None where the browser does not know the kind of key.
async function isSigned(der: Bytes, message: Bytes, signature: Bytes): Promise<boolean | undefined> {
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

const told = (is: boolean | undefined): string => (is === undefined ? "this browser cannot check this kind of key" : is ? "" : "it is not good");

export async function examine(link: Bytes): Promise<Proof> {
  const reader = new Reader(link);
  reader.expect(utf8("ledgerd evidence link v1\0"));
  const encoded = reader.part();
  const author = reader.part();
  const transactionPath = path(new Reader(reader.part()));
  const height = reader.u64();
  let previous = reader.take(32);
  const headers = Array.from({ length: reader.u32() }, () => ({ term: reader.take(8), time: reader.take(8), root: reader.take(32) }));
  const proof = new Reader(reader.part());
  reader.end();

  const checks: Check[] = [];
  const check = (what: string, holds: boolean, detail = ""): void => void checks.push({ what, holds, detail });

  const transaction = fromBinary(TransactionSchema, encoded);
  const body = fromBinary(TransactionBodySchema, transaction.body);
  const creator = certificate(author);
  check("The transaction names the certificate of its author", same(body.creator, await sha256(author)), `${creator.organisation}/${creator.commonName}`);
  const signed = await isSigned(author, concat(utf8("ledgerd transaction v1\0"), transaction.body), own(transaction.signature));
  check("Its author has signed it", signed === true, told(signed));
  const leaf = await sha256(Uint8Array.of(0), encoded);
  const inBlock = await root(transactionPath, leaf);
  check("It stands in its block", headers[0] !== undefined && same(inBlock, headers[0].root), `position ${transactionPath.index} of ${transactionPath.leaves}`);

  let at = height;
  for (const header of headers) {
    const number = new Uint8Array(8);
    new DataView(number.buffer).setBigUint64(0, at);
    previous = await sha256(utf8("ledgerd block v1\0"), number, header.term, header.time, previous, header.root);
    at += 1n;
  }
  const certified = at - 1n;

  proof.expect(utf8("ledgerd proof v1\0"));
  const certificateReader = new Reader(proof.part());
  certificateReader.expect(utf8("ledgerd certificate v1\0"));
  const prefix = utf8("ledgerd statement v1\0");
  const statement = certificateReader.take(prefix.length + 32 + 8 + 8 + 32 + 32);
  const fields = new Reader(statement);
  fields.expect(prefix);
  const network = fields.take(32);
  const statedHeight = fields.u64();
  fields.u64();
  const statedHash = fields.take(32);
  const results = fields.take(32);
  check("It is of the same network", same(network, body.network), hex(network).slice(0, 16));
  check("The headers lead to the certified block", statedHeight === certified && same(statedHash, previous), `block ${certified}, ${headers.length} header(s)`);

  const signers: string[] = [];
  const count = certificateReader.u32();
  for (let each = 0; each < count; each += 1) {
    certificateReader.u64();
    const der = certificateReader.part();
    const { organisation, commonName } = certificate(der);
    const good = await isSigned(der, statement, certificateReader.part());
    check(`${organisation}/${commonName} has signed what the block did`, good === true, told(good));
    if (good) signers.push(`${organisation}/${commonName}`);
  }

  const facts = proof.u32();
  for (let each = 0; each < facts; each += 1) {
    const fact = proof.part();
    const leads = await root(path(new Reader(proof.part())), await sha256(Uint8Array.of(0), fact));
    check("A fact belongs to the results that they signed", same(leads, results), factOf(fact));
  }
  return { bytes: link.length, height, certified, headers: headers.length, signers, checks };
}

function factOf(fact: Bytes): string {
  const kind = fact[utf8("ledgerd fact v1\0").length];
  return ["", "the ground: chains, state digest", "a verdict", "an event", "a control write"][kind ?? 0] ?? "";
}
