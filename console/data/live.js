// The robots, the feed and the node as they are now, from one stream of events that is opened again whenever it breaks.

import { get, hasEnded, lines } from "./api.js";
import { list, readStatus } from "./ledger.js";

/**
 * @typedef {import("../answers.js").LedgerEvent} LedgerEvent
 * @typedef {{
 *   key: string, time: number, height: number, name: string, subject: string, who: string, detail: string, code: string,
 *   transaction: string
 * }} Entry
 */

const FEED_MAX = 500;
const STATUS_MS = 2000;
const ROBOTS_MS = 5000;
const HEARTBEAT_MS = 2000;
const AGAIN_MS = 1000;
// The start of the feed, microseconds before now.
const PAST = 3_600_000_000;
const PAST_ROWS = 1000;

// Events of the feed: all about control and rights, without messages and renewals.
const EVENTS = [
  "granted", "released", "delegated", "pending", "confirmed", "queued", "left", "task", "stopped", "resumed", "side_door",
  "robot", "policy", "policy_proposed", "policy_approved", "policy_withdrawn", "registered", "revoked", "joined",
  "role_changed", "proposed", "approved", "executed", "failed", "withdrawn",
];
// For admins only.
const REFUSED = "refused";

/** What pages show of it. `delay` is the time from a block to the arrival of its events here, in milliseconds. */
export const live = {
  /** @type {import("../answers.js").Robot[] | undefined} */
  robots: undefined,
  /** @type {Entry[]} */
  feed: [],
  /** @type {import("../answers.js").Status | undefined} */
  status: undefined,
  connected: false,
  /** @type {number | undefined} */
  delay: undefined,
};

/** @type {AbortController | undefined} */
let stop;
let changed = () => {};

/** @param {() => void} listener called when something has changed */
export function onChange(listener) {
  changed = listener;
}

const pause = (/** @type {number} */ ms) => new Promise((resolve) => setTimeout(resolve, ms));

/** @param {boolean} isAdmin */
export function start(isAdmin) {
  stop?.abort();
  stop = new AbortController();
  const { signal } = stop;
  void repeated(signal, STATUS_MS, async () => void (live.status = await readStatus()));
  void repeated(signal, ROBOTS_MS, readRobots);
  void past().catch(() => undefined);
  void follow(signal, isAdmin ? [...EVENTS, REFUSED] : EVENTS);
}

export function halt() {
  stop?.abort();
  live.connected = false;
}

/**
 * @param {AbortSignal} signal
 * @param {number} everyMs
 * @param {() => Promise<void>} work
 */
async function repeated(signal, everyMs, work) {
  while (!signal.aborted) {
    await work().catch(() => undefined);
    changed();
    await pause(everyMs);
  }
}

export async function readRobots() {
  live.robots = await list("abac", "robots");
  changed();
}

async function past() {
  /** @type {import("../answers.js").Audit} */
  const { rows } = await get("/v1/audit", { since: Date.now() * 1000 - PAST, limit: PAST_ROWS });
  add(rows.filter((row) => row.decision !== "used" && row.decision !== "renewed").map(ofRow));
}

/** @param {import("../answers.js").AuditRow} row @returns {Entry} */
function ofRow({ time, height, decision, who, by, subject, robot, detail, code, transaction }) {
  const about = subject || robot;
  const shown = by && by !== who ? `by ${by}${detail ? `: ${detail}` : ""}` : detail;
  return { key: `${height}/${decision}/${about}/${who}`, time, height, name: decision, subject: about, who, detail: shown, code, transaction };
}

/** New entries in front, each once. @param {Entry[]} entries */
function add(entries) {
  const known = new Set(live.feed.map((entry) => entry.key));
  const fresh = entries.filter(({ key }) => !known.has(key) && known.add(key));
  if (fresh.length === 0) return;
  live.feed = [...fresh, ...live.feed].sort((one, other) => other.height - one.height || other.time - one.time).slice(0, FEED_MAX);
  changed();
}

/**
 * @param {AbortSignal} signal
 * @param {string[]} names
 */
async function follow(signal, names) {
  let from = 0;
  const connect = (/** @type {boolean} */ is) => {
    if (signal.aborted) return;
    live.connected = is;
    changed();
  };
  while (!signal.aborted) {
    try {
      /** @type {AsyncGenerator<import("../answers.js").Delivery, void>} */
      const deliveries = lines("/v1/events", { from_height: from, name: names, heartbeat_ms: HEARTBEAT_MS }, signal, () => connect(true));
      for await (const delivery of deliveries) {
        from = delivery.height + 1;
        if (delivery.events.length) received(delivery);
      }
    } catch (error) {
      if (hasEnded(error)) return;
    }
    connect(false);
    await pause(AGAIN_MS);
  }
}

/** @param {import("../answers.js").Delivery} delivery */
function received({ time, height, events }) {
  live.delay = Math.max(0, Date.now() - time / 1000);
  add(events.flatMap((event, at) => ofEvent(time, height, event, at)));
  void readRobots().catch(() => undefined);
}

/**
 * @param {number} time
 * @param {number} height
 * @param {LedgerEvent} event
 * @param {number} at
 * @returns {Entry[]}
 */
function ofEvent(time, height, { name, subject, payload }, at) {
  const told = payload.encoding === "json" && payload.response ? payload.response : {};
  const common = { time, height, name, transaction: "" };
  if (name === REFUSED && told.refusals) {
    /** @type {{ who?: string, subject?: string, code: number, why?: string, count: number }[]} */
    const refusals = told.refusals;
    return refusals.map(({ who = "", subject: about = "", code, why = "", count }, line) => ({
      ...common,
      key: `${height}/${name}/${about}/${who}/${line}`,
      subject: about,
      who,
      detail: count > 1 ? `${why} (${count} times)` : why,
      code: code ? `LGR-${code}` : "",
    }));
  }
  const who = told.holder ?? told.contender ?? told.receiver ?? told.by ?? "";
  const words = [told.change, told.id, told.state, told.position ? `position ${told.position}` : "", told.reason, told.message];
  const by = told.giver ? `from ${told.giver}` : told.by && told.by !== who ? `by ${told.by}` : "";
  const about = subject || [told.organisation, told.name].filter(Boolean).join("/");
  const key = name === "granted" || name === "released" ? `${height}/${name}/${subject}/${who}` : `${height}/${name}/${about}/${who}/${at}`;
  return [{ ...common, key, subject: about, who, detail: [...words, by].filter(Boolean).join(" · "), code: "" }];
}
