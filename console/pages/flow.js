// The messages of a service: rate and latency of the last minute, and the last ones.

import { Messages, WINDOW_S, quantile } from "../data/messages.js";
import { chart } from "../view/chart.js";
import { h, refresh } from "../view/dom.js";
import { atTime, rejected, table } from "../view/parts.js";

const TWIST = "geometry_msgs/msg/Twist";
// The rate is the mean of these seconds; the newest one is not over yet.
const MEAN_S = 5;

/** @param {number} one @param {number} other */
const ascending = (one, other) => one - other;

/** @param {number | undefined} value */
const milliseconds = (value) => (value === undefined ? "none" : `${value.toFixed(1)} ms`);

export class Flow {
  /**
   * @param {string} service
   * @param {string} type
   */
  constructor(service, type) {
    this.service = service;
    this.messages = new Messages(service, type === TWIST, refresh);
  }

  end() {
    this.messages.end();
  }

  show() {
    const { seconds, last, error } = this.messages;
    if (error !== undefined) return rejected(error);
    const recent = seconds.slice(-1 - MEAN_S, -1);
    const rate = recent.length ? recent.reduce((sum, { count }) => sum + count, 0) / recent.length : 0;
    const all = seconds.flatMap(({ latencies }) => latencies).sort(ascending);
    const [p50, p99] = [milliseconds(quantile(all, 0.5)), milliseconds(quantile(all, 0.99))];
    const sorted = seconds.map(({ latencies }) => [...latencies].sort(ascending));
    const of = (/** @type {number} */ part) => sorted.map((values) => quantile(values, part));
    const end = seconds.at(-1)?.at ?? Math.floor(Date.now() / 1000);
    return [
      h(
        "div.charts",
        h(
          "figure",
          h("figcaption", "Rate ", h("b", `${rate.toFixed(1)} a second`)),
          chart(`Messages a second: ${rate.toFixed(1)}`, "/s", [{ name: "first", values: seconds.map(({ count }) => count) }], end),
        ),
        h(
          "figure",
          h("figcaption", "Latency ", h("b", `p50 ${p50}`), " ", h("b", `p99 ${p99}`), " ", h("span.dim", "from the signature to this page")),
          chart(
            `Latency in the last ${WINDOW_S} s: p50 ${p50}, p99 ${p99}`,
            "ms",
            [
              { name: "first", values: of(0.5) },
              { name: "second", values: of(0.99) },
            ],
            end,
          ),
        ),
      ),
      last.length > 0 && table(`Last messages of ${this.service}`, ["Time", "Sender", "Sequence", "Latency", "Message"], last.map(row)),
    ];
  }
}

/** @param {import("../data/messages.js").Message} message */
function row({ at, sender, seq, latencyMs, words }) {
  return h("tr", h("td", atTime(at)), h("td", sender), h("td", seq), h("td", milliseconds(latencyMs)), h("td.wide", h("code", words)));
}
