// Small parts of pages.

import { clock, day, span, utc } from "../data/bytes.js";
import { rejectionOf } from "../data/api.js";
import { now } from "../data/ledger.js";
import { h, refresh } from "./dom.js";

/** @typedef {import("./dom.js").Child} Child */

/**
 * A page: its title gets the focus when it comes.
 * @param {string} title
 * @param {Child} aside
 * @param {...Child} children
 */
export function page(title, aside, ...children) {
  const shown = (/** @type {HTMLElement} */ heading) => {
    document.title = `${title} · ledgerd`;
    heading.focus({ preventScroll: true });
  };
  return [h("div.head", h("h1", { key: title, tabindex: -1, mounted: shown }, title), aside), children];
}

/** @param {unknown} error */
export function rejected(error) {
  if (error === undefined) return null;
  const { message, code, found, wanted, next } = rejectionOf(error);
  /** @type {[string, string][]} */
  const lines = [["found", found], ["wanted", wanted], ["try", next]];
  const shown = lines.filter(([, text]) => text);
  return h(
    "div.rejected",
    { role: "alert" },
    h("p", h("strong", withTimes(message)), " ", code && h("code", code)),
    shown.length > 0 && h("dl", shown.map(([name, text]) => [h("dt", name), h("dd", withTimes(text))])),
  );
}

/** Buttons whose work is under way, by the name that they have on their page. @type {Set<string>} */
const busy = new Set();

/**
 * A button for work that lasts: it cannot be pressed twice. Its rejection goes to `failed`.
 * @param {string} name unique on the page
 * @param {{ kind?: "danger" | "plain" | "main", disabled?: boolean, run: () => Promise<unknown>, failed: (error: unknown) => void }} work
 * @param {...Child} label
 */
export function action(name, { kind = "plain", disabled = false, run, failed }, ...label) {
  const pressed = async () => {
    if (busy.has(name)) return;
    busy.add(name);
    failed(undefined);
    refresh();
    try {
      await run();
    } catch (error) {
      failed(error);
    }
    busy.delete(name);
    refresh();
  };
  const isBusy = busy.has(name);
  return h(`button.${kind}`, { key: name, type: "button", disabled: isBusy || disabled, "aria-busy": isBusy, onclick: pressed }, label);
}

/** @param {number} until */
export function remaining(until) {
  const left = until - now();
  return h("span", { class: left < 3e6 ? "soon" : undefined }, left > 0 ? `${span(left)} left` : "ends now");
}

/**
 * A time as text, in UTC where the mouse is on it.
 * @param {number} us
 * @param {string} text
 */
const shownTime = (us, text) => h("time", { datetime: new Date(us / 1000).toISOString(), title: utc(us) }, text);

/** A time of day, and the day if it is not today. @param {number} us */
export const atTime = (us) => shownTime(us, day(us) === day(now()) ? clock(us) : `${day(us)} ${clock(us)}`);

/** A day and a time. @param {number} us */
export const atMoment = (us) => shownTime(us, `${day(us)} ${clock(us)}`);

/** A day. @param {number} us */
export const onDay = (us) => shownTime(us, day(us));

/** @param {...Child} children */
export const empty = (...children) => h("p.empty", children);

/**
 * A table. On a narrow screen each row is a block, and each cell has the name of its column.
 * @param {string} label
 * @param {string[]} head
 * @param {import("./dom.js").Described[]} rows
 */
export function table(label, head, rows) {
  for (const { children } of rows) {
    children.forEach((cell, at) => {
      if (typeof cell !== "string") cell.props["data-name"] = cell.props["colspan"] ? "" : (head[at] ?? "");
    });
  }
  return h(
    "div.scroll",
    { key: label, role: "region", "aria-label": label, tabindex: 0 },
    h("table", h("caption.unseen", label), h("thead", h("tr", head.map((name) => (name ? h("th", { scope: "col" }, name) : h("td"))))), h("tbody", rows)),
  );
}

/** @param {(false | null | undefined | [string, Child])[]} pairs */
export const facts = (...pairs) =>
  h("dl.facts", pairs.map((pair) => pair && h("div", { key: pair[0] }, h("dt", pair[0]), h("dd", pair[1]))));

/** @param {...string} parts */
export const address = (...parts) => `#/${parts.map(encodeURIComponent).join("/")}`;

/** What something is about, with links to robots. @param {import("../data/calls.js").Subject[]} about */
export const subjects = (about) => about.map(({ text, robot }, at) => [at > 0 && ", ", robot ? h("a", { href: address("robots", robot) }, text) : text]);

// A time as the ledger writes it, and the same in microseconds behind it.
const WRITTEN = /(\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d(?:\.\d+)?Z)(?: \(\d+ µs\))?/;

/** A text of the ledger with the times in it as people read them here. @param {string} text */
export const withTimes = (text) => text.split(WRITTEN).map((part, at) => (at % 2 === 1 ? atTime(Date.parse(part) * 1000) : part));

/**
 * An answer that is asked for again and again, as long as its page is shown.
 * @template T
 */
export class Asked {
  /** @type {T | undefined} */
  answer;
  /** @type {unknown} */
  error;
  #shown = true;
  /** @type {ReturnType<typeof setInterval> | undefined} */
  #timer;

  /**
   * @param {() => Promise<T>} ask
   * @param {number} everyMs 0: once
   */
  constructor(ask, everyMs = 0) {
    this.ask = ask;
    void this.again();
    if (everyMs) this.#timer = setInterval(() => void this.again(), everyMs);
  }

  async again() {
    try {
      const answer = await this.ask();
      this.error = undefined;
      this.answer = answer;
    } catch (error) {
      this.error = error;
    }
    if (this.#shown) refresh();
  }

  end() {
    this.#shown = false;
    clearInterval(this.#timer);
  }
}
