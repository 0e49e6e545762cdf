// A transaction, and its proof.

import { get } from "../data/api.js";
import { unhex } from "../data/bytes.js";
import { wordsOf } from "../data/calls.js";
import { h } from "../view/dom.js";
import { Asked, action, address, atMoment, facts, page, rejected, subjects } from "../view/parts.js";

/**
 * @typedef {import("../answers.js").Transaction} Transaction
 * @typedef {import("../answers.js").LedgerEvent} LedgerEvent
 * @typedef {import("../answers.js").Answer} Answer
 * @typedef {import("../data/proof.js").Proof} Proof
 */

const HEX_DIGITS_SHOWN = 96;

/** @param {Transaction} transaction */
const callOf = ({ chaincode, function: name }) => (chaincode ? `${chaincode} ${name}` : "not readable for you");

/** @param {Transaction} transaction */
export const verdict = ({ code }) => (code === "OK" ? h("span.what.good", "executed") : h("span.what.warn", code));

/** @param {Answer} answer */
function text({ encoding, response }) {
  if (encoding === "json") return JSON.stringify(response);
  if (encoding === "text") return response;
  return `0x${response.slice(0, HEX_DIGITS_SHOWN)}${response.length > HEX_DIGITS_SHOWN ? "…" : ""}`;
}

/** @param {LedgerEvent[]} events */
export const eventsOf = (events) =>
  h("ul", events.map(({ name, subject, payload }) => h("li", `${name} ${subject} `, h("code", text(payload)))));

/** @param {import("../main.js").Visit} visit */
export function open({ parts: [id = ""] }) {
  const path = `/v1/transactions/${encodeURIComponent(id)}`;
  /** @type {Asked<Transaction>} */
  const asked = new Asked(() => get(path));
  const proof = new ProofSection(path);
  return {
    end: () => asked.end(),
    show: () => page("Transaction", null, rejected(asked.error), asked.answer && [contents(asked.answer), proof.show()]),
  };
}

/** @param {Transaction} transaction */
function contents(transaction) {
  const { id, creator, height, index, time, code, message, not_after: notAfter, args, events } = transaction;
  return [
    facts(
      ["Id", h("code", id)],
      ["Signer", creator],
      ["Action", wordsOf(transaction).action],
      ["About", subjects(wordsOf(transaction).about)],
      ["Call", callOf(transaction)],
      ["Block", [h("a", { href: address("blocks", String(height)) }, height), `, position ${index}, `, atMoment(time)]],
      ["Verdict", code === "OK" ? "executed" : [h("code", code), " ", message]],
      notAfter > 0 && ["Valid until", atMoment(notAfter)],
    ),
    args.length > 0 && [h("h2", "Arguments"), h("ol.arguments", args.map((each) => h("li", h("code", text(each)))))],
    events.length > 0 && [h("h2", "Events"), eventsOf(events)],
  ];
}

/** The proof, once it is asked for. */
class ProofSection {
  /** @type {Proof | undefined} */
  #proof;
  /** @type {unknown} */
  #error;

  /** @param {string} path */
  constructor(path) {
    this.path = path;
  }

  async #run() {
    const { examine } = await import("../data/proof.js");
    /** @type {{ link: string }} */
    const { link } = await get(`${this.path}/proof`);
    this.#proof = await examine(unhex(link));
  }

  show() {
    const failed = (/** @type {unknown} */ error) => void (this.#error = error);
    return h(
      "section",
      { "aria-label": "Proof" },
      h("h2", "Proof"),
      h("p.dim", "The node gives a proof; this browser checks it. Whether the signers were the voters at that time, ledgerctl prove shows from the genesis on."),
      h("div.actions", action("proof", { kind: "main", run: () => this.#run(), failed }, "Check the proof")),
      rejected(this.#error),
      this.#proof && checks(this.#proof),
    );
  }
}

/** @param {Proof} proof */
function checks({ checks, signers }) {
  const holds = checks.every((check) => check.holds);
  return [
    h("p.summary", { role: "status" }, holds ? `The proof holds: signed by ${signers.join(", ")}.` : "A part of the proof does not hold."),
    h(
      "ul.checks",
      checks.map(({ what, holds, detail }) =>
        h(holds ? "li.holds" : "li.fails", h("span", { "aria-hidden": true }, holds ? "✓" : "✗"), ` ${what}`, !holds && " — does not hold", " ", detail && h("span.dim", detail)),
      ),
    ),
  ];
}
