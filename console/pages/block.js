// A block with its transactions.

import { get } from "../data/api.js";
import { wordsOf } from "../data/calls.js";
import { h } from "../view/dom.js";
import { Asked, address, atMoment, empty, facts, page, rejected, subjects, table } from "../view/parts.js";
import { eventsOf, verdict } from "./transaction.js";

/**
 * @typedef {import("../answers.js").Block} Block
 * @typedef {import("../answers.js").Transaction} Transaction
 */

/** @param {import("../main.js").Visit} visit */
export function open({ parts: [height = ""] }) {
  /** @type {Asked<Block>} */
  const asked = new Asked(() => get(`/v1/blocks/${encodeURIComponent(height)}`));
  return {
    end: () => asked.end(),
    show: () => page(`Block ${height}`, null, rejected(asked.error), asked.answer && contents(asked.answer)),
  };
}

/** @param {Block} block */
function contents({ height, time, term, hash, previous_hash: previous, root, state_digest: digest, kind, transactions, events }) {
  const before = address("blocks", String(Math.max(0, height - 1)));
  return [
    facts(
      ["Time", atMoment(time)],
      ["Term", term],
      ["Hash", h("code", hash)],
      ["Block before", h("a", { href: before }, h("code", previous))],
      ["Root of the transactions", h("code", root)],
      ["State digest", h("code", digest)],
    ),
    h("h2", "Transactions"),
    transactions.length === 0 && empty(`None: ${kind}.`),
    transactions.length > 0 && table("Transactions", ["Position", "Who", "Action", "About", "Verdict", "Id"], transactions.map(row)),
    events.length > 0 && [h("h2", "Events of the block itself"), eventsOf(events)],
  ];
}

/** @param {Transaction} transaction */
function row(transaction) {
  const { id, index, creator } = transaction;
  const { action, about } = wordsOf(transaction);
  return h(
    "tr",
    { key: id },
    h("td", index),
    h("td", creator),
    h("td", action),
    h("td", subjects(about)),
    h("td", verdict(transaction)),
    h("td", h("a", { href: address("tx", id) }, h("code", id.slice(0, 16)))),
  );
}
