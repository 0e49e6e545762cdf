// The newest blocks, and a search.

import { get } from "../data/api.js";
import { happened } from "../data/calls.js";
import { live } from "../data/live.js";
import { h, refresh } from "../view/dom.js";
import { Asked, address, atMoment, atTime, empty, page, rejected, subjects, table, withTimes } from "../view/parts.js";

/**
 * @typedef {import("../answers.js").Block} Block
 * @typedef {import("../answers.js").AuditRow} AuditRow
 * @typedef {import("../answers.js").Audit} Audit
 */

const BLOCKS = 20;
const ROWS = 200;
// Most lines of a block.
const LINES_MAX = 6;

/** @param {import("../main.js").Visit} visit */
export function open({ place, parts }) {
  const search = place === "search" ? parts.join("/") : "";
  const found = search ? new Found(search) : new Newest();
  let asked = search;
  const submit = (/** @type {Event} */ event) => {
    event.preventDefault();
    const wanted = asked.trim();
    if (/^\d+$/.test(wanted)) location.hash = address("blocks", wanted);
    else if (/^[0-9a-f]{64}$/i.test(wanted)) location.hash = address("tx", wanted.toLowerCase());
    else location.hash = address("search", wanted);
  };
  return {
    end: () => found.end(),
    show: () =>
      page(
        "Blocks",
        null,
        h(
          "form.search.wide",
          { role: "search", onsubmit: submit },
          h(
            "label",
            h("span.unseen", "Search by robot, user, id of a transaction, or height"),
            h("input", {
              type: "search",
              value: asked,
              placeholder: "Robot, ORGANISATION/USER, transaction id, or height",
              oninput: (/** @type {any} */ event) => void (asked = event.target.value),
            }),
          ),
          h("button.main", { type: "submit" }, "Search"),
        ),
        found.show(),
      ),
  };
}

/** The newest blocks; each is asked for once. */
class Newest {
  /** @type {Map<number, Block>} */
  #blocks = new Map();
  #height = 0;
  /** @type {unknown} */
  #error;

  end() {}

  async #read() {
    const height = live.status?.height ?? 0;
    if (height === this.#height) return;
    this.#height = height;
    const wanted = Array.from({ length: BLOCKS }, (_, back) => height - back).filter((at) => at > 0);
    try {
      const blocks = await Promise.all(wanted.map(async (at) => this.#blocks.get(at) ?? get(`/v1/blocks/${at}`)));
      this.#blocks = new Map(blocks.map((block) => [block.height, block]));
      this.#error = undefined;
    } catch (error) {
      this.#error = error;
    }
    refresh();
  }

  show() {
    void this.#read();
    if (this.#error !== undefined) return rejected(this.#error);
    return table("The newest blocks", ["Height", "Time", "What happened", "Rejected", "Hash"], [...this.#blocks.values()].map(block));
  }
}

/** @param {Block} block */
function block(block) {
  const { height, time, transactions, hash } = block;
  return h(
    "tr",
    { key: height },
    h("td", h("a", { href: address("blocks", String(height)) }, height)),
    h("td", atTime(time)),
    h("td.wide", summary(block)),
    h("td", transactions.filter(({ code }) => code !== "OK").length || ""),
    h("td", h("code", hash.slice(0, 12))),
  );
}

/** Who did what with which robot. @param {Block} block */
function summary(block) {
  const found = happened(block);
  if (found.length === 0) return h("span.dim", block.kind === "transactions" ? "empty" : block.kind);
  const shown = found.slice(0, LINES_MAX);
  return h(
    "ul.happened",
    shown.map(({ who, action, about, count }) => h("li", who && [h("b", who), " "], action, " ", subjects(about), count > 1 && h("span.dim", ` ×${count}`))),
    found.length > LINES_MAX && h("li.dim", `and ${found.length - LINES_MAX} more`),
  );
}

/** Rows of the audit about a robot or a user. */
class Found {
  /** @param {string} words */
  constructor(words) {
    this.words = words;
    const question = words.includes("/") ? { user: words } : { robot: words };
    /** @type {Asked<Audit>} */
    this.asked = new Asked(() => get("/v1/audit", { ...question, limit: ROWS }));
  }

  end() {
    this.asked.end();
  }

  show() {
    const { answer, error } = this.asked;
    if (error !== undefined) return rejected(error);
    if (!answer) return empty("Searching…");
    const { words } = this;
    if (answer.rows.length === 0) return empty(`Nothing about “${words}”. A user is ORGANISATION/NAME.`);
    return [
      h("p.summary", `${answer.rows.length} decisions about ${words}`, answer.more && ", the oldest first; there are more: ledgerctl audit"),
      table(`Decisions about ${words}`, ["Time", "Decision", "About", "Who", "Detail", "Transaction"], [...answer.rows].reverse().map(decision)),
    ];
  }
}

/** @param {AuditRow} row */
function decision({ time, decision, count, subject, robot, who, code, detail, transaction, height }) {
  return h(
    "tr",
    h("td", atMoment(time)),
    h("td", count > 1 ? `${decision} ×${count}` : decision),
    h("td", subject || robot),
    h("td", who),
    h("td.wide", code && [h("code", code), " "], withTimes(detail)),
    h("td", transaction ? h("a", { href: address("tx", transaction) }, h("code", transaction.slice(0, 12))) : h("a", { href: address("blocks", String(height)) }, `block ${height}`)),
  );
}
