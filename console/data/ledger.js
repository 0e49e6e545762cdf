// Questions to the ledger, and transactions that this browser signs.

import { get, post, postBytes } from "./api.js";
import { concat, unhex, utf8 } from "./bytes.js";
import { creatorOf, sign } from "./identity.js";
import { PREFIX, encodeBody, encodeTransaction } from "./transaction.js";

/** @typedef {import("./identity.js").Identity} Identity */

// Microseconds for which a transaction is good.
const LIFE = 10_000_000;
const NONCE_BYTES = 16;
// Most calls that a resume names.
const NAMED_MAX = 64;

// The node's clock minus that of this machine, microseconds.
let offset = 0;

export const now = () => Date.now() * 1000 + offset;

/** @returns {Promise<import("../answers.js").Status>} */
export async function readStatus() {
  const asked = Date.now();
  /** @type {import("../answers.js").Status} */
  const status = await get("/v1/status");
  offset = status.clock - ((asked + Date.now()) / 2) * 1000;
  return status;
}

/**
 * @template T
 * @param {string} chaincode
 * @param {string} name
 * @param {string[]} args
 * @param {boolean} isCurrent does the answer need everything that was acknowledged before?
 * @returns {Promise<T>}
 */
export async function query(chaincode, name, args = [], isCurrent = false) {
  /** @type {{ response: T }} */
  const answer = await post("/v1/query", { chaincode, function: name, args, may_be_stale: !isCurrent });
  return answer.response;
}

/**
 * All elements of a list, page by page.
 * @template T
 * @param {string} chaincode
 * @param {string} name
 * @returns {Promise<T[]>}
 */
export async function list(chaincode, name) {
  /** @type {T[]} */
  const found = [];
  /** @type {string | undefined} */
  let after;
  do {
    /** @type {{ items: T[], next?: string }} */
    const page = await query(chaincode, name, [JSON.stringify({ after })]);
    found.push(...page.items);
    after = page.next;
  } while (after !== undefined);
  return found;
}

/**
 * The stops of a robot without a verdict, as a resume names them to cancel them.
 * @param {string} robot
 */
export async function openStops(robot) {
  const { open_stops: open = [] } = await readStatus();
  const own = open.filter((stop) => stop.robot === robot || stop.robot === "*");
  return own.slice(0, NAMED_MAX).map((stop) => `${stop.transaction}:${stop.not_after}`);
}

/**
 * Builds, signs and submits a call, and waits for its verdict.
 * @param {Identity} identity
 * @param {string} chaincode
 * @param {string} name
 * @param {...string} args
 */
export async function invoke(identity, chaincode, name, ...args) {
  const body = encodeBody({
    network: unhex(identity.network),
    creator: await creatorOf(identity),
    nonce: crypto.getRandomValues(new Uint8Array(NONCE_BYTES)),
    notAfter: BigInt(Math.round(now()) + LIFE),
    chaincode,
    function: name,
    args: args.map(utf8),
  });
  const signature = await sign(identity.key, concat(PREFIX, body));
  const transaction = encodeTransaction({ body, signature, certificate: identity.certificate });
  await postBytes("/v1/transactions", { first_attempt: true }, transaction);
}
