// Messages of a service as they arrive: rate, latency, and the last ones decoded.

import { hasEnded, isDenied, lines } from "./api.js";
import { unhex, utf8 } from "./bytes.js";
import { now } from "./ledger.js";
import { shown } from "./payload.js";

/** @typedef {{ at: number, sender: string, seq: number, latencyMs: number, words: string }} Message */
/** One point of the charts. @typedef {{ at: number, count: number, latencies: number[] }} Second */

// Bridges and ledgerctl sign a message for this long, microseconds: so its signature says when it was made.
const SIGNED_FOR = 2_000_000;
const LAST_MAX = 12;
const AGAIN_MS = 1000;
const HEARTBEAT_MS = 1000;
export const WINDOW_S = 60;

/**
 * @param {number[]} sorted
 * @param {number} part
 */
export const quantile = (sorted, part) => sorted[Math.min(sorted.length - 1, Math.floor(sorted.length * part))];

export class Messages {
  /** @type {Message[]} */
  last = [];
  /** @type {Second[]} */
  seconds = [];
  /** @type {unknown} */
  error;
  #stop = new AbortController();

  /**
   * @param {string} service
   * @param {boolean} isTwist
   * @param {() => void} changed
   */
  constructor(service, isTwist, changed) {
    this.service = service;
    this.isTwist = isTwist;
    this.changed = changed;
    void this.#follow();
  }

  end() {
    this.#stop.abort();
  }

  async #follow() {
    const { signal } = this.#stop;
    const wanted = { chaincode: "abac", subject: this.service, name: "message", heartbeat_ms: HEARTBEAT_MS };
    while (!signal.aborted) {
      try {
        /** @type {AsyncGenerator<import("../answers.js").Delivery, void>} */
        const deliveries = lines("/v1/events", wanted, signal);
        for await (const { events } of deliveries) {
          this.error = undefined;
          this.#second();
          for (const event of events) this.#received(event);
          this.changed();
        }
      } catch (error) {
        if (signal.aborted || hasEnded(error)) return;
        this.error = error;
        this.changed();
        // A right that is missing does not return by asking, and each question would be recorded as denied.
        if (isDenied(error)) return;
      }
      await new Promise((resolve) => setTimeout(resolve, AGAIN_MS));
    }
  }

  /** @param {import("../answers.js").LedgerEvent} event */
  #received({ payload, transaction }) {
    if (!transaction) return;
    /** @type {{ first_seq: number, count: number }} */
    const { first_seq: first, count } = payload.response;
    const latencyMs = Math.max(0, (now() - (transaction.not_after - SIGNED_FOR)) / 1000);
    const last = transaction.args.at(-1);
    const bytes = last?.encoding === "hex" ? unhex(last.response) : utf8(String(last?.response ?? ""));
    this.last.unshift({ at: Date.now() * 1000, sender: transaction.creator ?? "", seq: first + count - 1, latencyMs, words: shown(bytes, this.isTwist) });
    this.last.length = Math.min(this.last.length, LAST_MAX);
    const second = this.#second();
    second.count += count;
    second.latencies.push(latencyMs);
  }

  /** The present second, after empty ones for those without a message. @returns {Second} */
  #second() {
    const at = Math.floor(Date.now() / 1000);
    const newest = this.seconds.at(-1);
    for (let next = newest ? Math.max(newest.at + 1, at - WINDOW_S) : at; next <= at; next += 1) this.seconds.push({ at: next, count: 0, latencies: [] });
    while (this.seconds.length > WINDOW_S) this.seconds.shift();
    return /** @type {Second} */ (this.seconds.at(-1));
  }
}
