// What happened: grants, rejections, revocations, stops.

import { live } from "../data/live.js";
import { h, refresh } from "../view/dom.js";
import { address, atTime, empty, page, table, withTimes } from "../view/parts.js";

/** @typedef {import("../data/live.js").Entry} Entry */

/** @type {Record<string, string[]>} */
const KINDS = {
  all: [],
  grants: ["granted", "released", "delegated", "queued", "left", "pending", "confirmed"],
  rejections: ["refused"],
  revocations: ["revoked"],
  stops: ["stopped", "resumed"],
};

/** @type {Record<string, string>} */
const TONES = { granted: "good", resumed: "good", refused: "warn", revoked: "bad", stopped: "bad", side_door: "warn" };

export function open() {
  let kind = "all";
  const tab = (/** @type {string} */ name) =>
    h("button", { key: name, type: "button", "aria-pressed": name === kind, onclick: () => ((kind = name), refresh()) }, name);
  return {
    show() {
      const wanted = KINDS[kind] ?? [];
      return page(
        "Feed",
        h("span.dim", live.delay !== undefined && `newest event: ${Math.round(live.delay)} ms after its block`),
        h("div.tabs", { role: "group", "aria-label": "Kinds of entries" }, Object.keys(KINDS).map(tab)),
        h("div", { "aria-live": "polite", "aria-relevant": "additions" }, entries(live.feed.filter(({ name }) => wanted.length === 0 || wanted.includes(name)))),
      );
    },
  };
}

/** @param {Entry[]} shown */
export function entries(shown) {
  if (shown.length === 0) return empty("Nothing yet.");
  return table("Entries", ["Time", "What", "About", "Who", "Detail", "Block"], shown.map(row));
}

/** The robot of a robot's or a service's name. @param {string} subject */
const robotOf = (subject) => subject.split("/")[0] ?? "";

/** @param {string} subject */
const isAboutRobot = (subject) => live.robots?.some(({ Name }) => Name === robotOf(subject)) === true;

/** @param {Entry} entry */
function row({ key, time, name, subject, who, code, detail, transaction, height }) {
  return h(
    "tr",
    { key },
    h("td", atTime(time)),
    h("td", h("span.what", { class: TONES[name] }, name)),
    h("td", isAboutRobot(subject) ? h("a", { href: address("robots", robotOf(subject)) }, subject) : subject),
    h("td", who),
    h("td.wide", code && [h("code", code), " "], withTimes(detail)),
    h("td", h("a", { href: transaction ? address("tx", transaction) : address("blocks", String(height)) }, height)),
  );
}
