// Questions to the ledger, and transactions that this browser signs.

import { create, toBinary } from "@bufbuild/protobuf";
import { type Bytes, concat, own, text, utf8 } from "./bytes";
import { TransactionBodySchema, TransactionSchema } from "./gen/ledgerd/v1/transaction_pb";
import { type Identity, creatorOf, sign } from "./identity";
import { accepted } from "./refusal";
import { gateway } from "./session";
import { unhex } from "./bytes";

// Microseconds for which a transaction is good.
const LIFE = 10_000_000n;
const NONCE_BYTES = 16;
const PREFIX = utf8("ledgerd transaction v1\0");

// The node's clock minus that of this machine, microseconds.
let offset = 0;

export const now = (): number => Date.now() * 1000 + offset;

// Learns the node's clock from an answer that was asked for at this time (milliseconds).
export function learnClock(clock: bigint, asked: number): void {
  offset = Number(clock) - ((asked + Date.now()) / 2) * 1000;
}

export async function query<T>(chaincode: string, name: string, ...args: string[]): Promise<T> {
  const answer = await gateway.query({ chaincode, function: name, args: args.map(utf8), mayBeStale: true });
  accepted(answer.verdict);
  return JSON.parse(text(answer.response)) as T;
}

interface Page<T> {
  items: T[];
  next?: string;
}

// All elements of a list, page by page.
export async function list<T>(chaincode: string, name: string): Promise<T[]> {
  const found: T[] = [];
  let page: Page<T> = { items: [], next: "" };
  while (page.next !== undefined) {
    page = await query<Page<T>>(chaincode, name, JSON.stringify(page.next ? { after: page.next } : {}));
    found.push(...page.items);
  }
  return found;
}

export interface Done {
  id: Bytes;
  height: bigint;
  response: string;
}

// Builds, signs and submits a call, and waits for its verdict.
export async function invoke(identity: Identity, chaincode: string, name: string, ...args: string[]): Promise<Done> {
  const body = toBinary(
    TransactionBodySchema,
    create(TransactionBodySchema, {
      network: unhex(identity.network),
      creator: await creatorOf(identity),
      nonce: crypto.getRandomValues(new Uint8Array(NONCE_BYTES)),
      notAfter: BigInt(Math.round(now())) + LIFE,
      chaincode,
      function: name,
      args: args.map(utf8),
    }),
  );
  const signature = await sign(identity.key, concat(PREFIX, body));
  const signed = create(TransactionSchema, { body, signature, certificate: identity.certificate });
  const answer = await gateway.submit({ transaction: toBinary(TransactionSchema, signed), firstAttempt: true });
  accepted(answer.verdict);
  return { id: own(answer.id), height: answer.height, response: text(answer.response) };
}
