// What moves: the robots, the feed and the node, from one stream of events that is opened again whenever it breaks.

import type { AuditRow, Delivery, StatusResponse } from "./gen/ledgerd/v1/gateway_pb";
import { text } from "./bytes";
import type { Robot } from "./contract";
import { learnClock, list } from "./ledger";
import { hasEnded } from "./refusal";
import { gateway } from "./session";
import { Store } from "./store";

const FEED_MAX = 500;
const STATUS_MS = 2000;
const ROBOTS_MS = 5000;
const HEARTBEAT_MS = 2000;
const AGAIN_MS = 1000;
// How far back the feed begins, microseconds.
const PAST = 3_600_000_000n;
const PAST_ROWS = 1000;

// Events of the feed: all that is about control and rights, without messages and renewals.
const EVENTS = [
  "granted", "released", "delegated", "pending", "confirmed", "queued", "left", "task", "stopped", "resumed", "side_door",
  "robot", "policy", "policy_proposed", "policy_approved", "policy_withdrawn", "registered", "revoked", "joined",
  "role_changed", "proposed", "approved", "executed", "failed", "withdrawn",
];
// For admins only.
const REFUSED = "refused";

export interface Entry {
  key: string;
  time: number;
  height: number;
  name: string;
  subject: string;
  who: string;
  detail: string;
  code: string;
  transaction?: Uint8Array;
}

export const robots = new Store<Robot[] | undefined>(undefined);
export const feed = new Store<Entry[]>([]);
export const status = new Store<StatusResponse | undefined>(undefined);
export const connected = new Store(false);
// Milliseconds between the newest event's block time and its arrival here.
export const delay = new Store<number | undefined>(undefined);

let stop: AbortController | undefined;

const pause = (ms: number): Promise<void> => new Promise((resolve) => setTimeout(resolve, ms));

export function start(isAdmin: boolean): void {
  stop?.abort();
  const running = new AbortController();
  stop = running;
  void repeated(running.signal, STATUS_MS, readStatus);
  void repeated(running.signal, ROBOTS_MS, readRobots);
  void past().catch(() => undefined);
  void follow(running.signal, isAdmin ? [...EVENTS, REFUSED] : EVENTS);
}

export function halt(): void {
  stop?.abort();
  connected.set(false);
}

async function repeated(signal: AbortSignal, everyMs: number, work: () => Promise<void>): Promise<void> {
  while (!signal.aborted) {
    await work().catch(() => undefined);
    await pause(everyMs);
  }
}

async function readStatus(): Promise<void> {
  const asked = Date.now();
  const told = await gateway.status({});
  learnClock(told.clock, asked);
  status.set(told);
}

export async function readRobots(): Promise<void> {
  robots.set(await list<Robot>("abac", "robots"));
}

async function past(): Promise<void> {
  const since = BigInt(Date.now()) * 1000n - PAST;
  const { rows } = await gateway.audit({ since, limit: PAST_ROWS });
  add(rows.filter((row) => row.decision !== "used" && row.decision !== "renewed").map(ofRow));
}

function ofRow(row: AuditRow): Entry {
  const { time, height, decision, who, by, subject, robot, detail, code } = row;
  const key = `${height}/${decision}/${subject || robot}/${who}`;
  const shown = by && by !== who ? `by ${by}${detail ? `: ${detail}` : ""}` : detail;
  const entry = { key, time: Number(time), height: Number(height), name: decision, subject: subject || robot, who, detail: shown };
  return { ...entry, code: code ? `LGR-${code}` : "", transaction: row.transaction.length ? row.transaction : undefined };
}

// New entries in front, each once.
function add(entries: Entry[]): void {
  const known = new Set(feed.get().map((entry) => entry.key));
  const fresh = entries.filter((entry) => !known.has(entry.key));
  if (fresh.length === 0) return;
  feed.set([...fresh, ...feed.get()].sort((one, other) => other.height - one.height || other.time - one.time).slice(0, FEED_MAX));
}

async function follow(signal: AbortSignal, names: string[]): Promise<void> {
  let from = 0n;
  while (!signal.aborted) {
    try {
      const stream = gateway.subscribe({ fromHeight: from, names, heartbeatMs: HEARTBEAT_MS }, { signal, onHeader: () => connected.set(true) });
      for await (const delivery of stream) {
        if (delivery.early) continue;
        from = delivery.height + 1n;
        if (delivery.events.length) heard(delivery);
      }
    } catch (error) {
      connected.set(false);
      if (hasEnded(error)) return;
    }
    connected.set(false);
    await pause(AGAIN_MS);
  }
}

function heard(delivery: Delivery): void {
  delay.set(Math.max(0, Date.now() - Number(delivery.time) / 1000));
  add(delivery.events.flatMap((event, at) => ofEvent(delivery, event.name, event.subject, text(event.payload), at)));
  void readRobots().catch(() => undefined);
}

interface Payload {
  holder?: string;
  contender?: string;
  receiver?: string;
  giver?: string;
  by?: string;
  reason?: string;
  message?: string;
  change?: string;
  id?: string;
  position?: number;
  name?: string;
  organisation?: string;
  state?: string;
  refusals?: { who?: string; subject?: string; code: number; why?: string; count: number; found?: string }[];
}

function ofEvent({ time, height }: Delivery, name: string, subject: string, json: string, at: number): Entry[] {
  let told: Payload = {};
  try {
    told = JSON.parse(json) as Payload;
  } catch {
    // An event of a chaincode of somebody's own.
  }
  const common = { time: Number(time), height: Number(height), name };
  if (name === REFUSED && told.refusals) {
    return told.refusals.map(({ who = "", subject: about = "", code, why = "", count }, line) => ({
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
