// Policies: those in force, their history, and how two sets differ.

import { diff } from "../data/diff.js";
import { list, query } from "../data/ledger.js";
import { live } from "../data/live.js";
import { h, refresh } from "../view/dom.js";
import { meaningsOf, unknownNames } from "../view/meaning.js";
import { Asked, action, address, atMoment, empty, page, rejected, table } from "../view/parts.js";

/**
 * @typedef {import("../answers.js").Policy} Policy
 * @typedef {import("../answers.js").PolicySet} PolicySet
 * @typedef {import("../answers.js").PolicyCheck} PolicyCheck
 * @typedef {{ title: string, policies: { id: string, lines: import("../data/diff.js").Line[] }[] }} Changes
 */

const EVERY_MS = 5000;
// So few policies are shown open.
const OPEN_MAX = 3;
const ALL_UNMATCHED = "applies to no one today";
const SIGNS = { same: "  ", gone: "- ", new: "+ " };

/** @param {import("../main.js").Visit} visit */
export function open({ parts: [chosen], identity }) {
  const organisation = chosen || identity.organisation;
  /** @type {Asked<Policy[]>} */
  const policies = new Asked(() => list("abac", "policies"), EVERY_MS);
  /** @type {Asked<PolicySet[]>} */
  const sets = new Asked(() => query("abac", "policy_history", [organisation]), EVERY_MS);
  const checks = new Checks();
  /** @type {Changes | undefined} */
  let changes;
  /** @type {unknown} */
  let error;
  const failed = (/** @type {unknown} */ found) => void (error = found);
  const compare = (/** @type {number} */ version) => async () => void (changes = await changed(organisation, version));

  const tab = (/** @type {string} */ name) =>
    h("button", { key: name, type: "button", "aria-pressed": name === organisation, onclick: () => (location.hash = address("policies", name)) }, name);

  /** @param {PolicySet} set */
  const row = ({ version, time, by, message, restores, break_glass: breakGlass, height }) =>
    h(
      "tr",
      { key: version },
      h("td", version),
      h("td", atMoment(time)),
      h("td", by),
      h("td.wide", message, restores !== undefined && ` restores ${restores}`, breakGlass && [" ", h("span.what.bad", "break glass")]),
      h("td", h("a", { href: address("blocks", String(height)) }, height)),
      h("td", action(`changes ${version}`, { run: compare(version), failed }, "Changes", h("span.unseen", ` of set ${version}`))),
    );

  return {
    end() {
      policies.end();
      sets.end();
    },
    show() {
      const all = policies.answer ?? [];
      const owners = live.robots?.map((robot) => robot.organisation) ?? [];
      const organisations = new Set([identity.organisation, ...owners, ...all.map((policy) => policy.organisation)].filter(Boolean));
      const theirs = all.filter((policy) => policy.organisation === organisation);
      // The default of the network has no owner.
      const shown = theirs.length ? theirs : all.filter((policy) => !policy.organisation);
      return page(
        "Policies",
        h("a", { href: address("access") }, "Who may do what"),
        h("div.tabs", { role: "group", "aria-label": "Organisations" }, [...organisations].sort().map(tab)),
        rejected(policies.error),
        h("h2", "In force"),
        policies.answer && theirs.length === 0 && h("p.dim", `${organisation} has no policies of its own. The default decides.`),
        idle(shown.filter(({ text }) => checks.unmatched(text) === ALL_UNMATCHED).map(({ id }) => id)),
        shown.map(({ id, text }) => {
          const check = checks.of(text);
          const [idle, hasUnknown] = [checks.unmatched(text), (check?.unknown.length ?? 0) > 0];
          return h(
            "details",
            { key: id, open: shown.length <= OPEN_MAX },
            h("summary", id, idle && [" ", h("span.what.warn", idle)], hasUnknown && [" ", h("span.what.warn", "unknown name")]),
            check && [unknownNames(check.unknown), meaningsOf(check.policies)],
            h("pre", { tabindex: 0 }, text),
          );
        }),
        h("h2", "History"),
        rejected(sets.error),
        sets.answer?.length === 0 && empty("No set has a number yet."),
        sets.answer && sets.answer.length > 0 && table(`Sets of policies of ${organisation}`, ["Set", "Time", "By", "Message", "Block", ""], sets.answer.map(row)),
        rejected(error),
        changes && differences(changes),
      );
    },
  };
}

/** @param {string[]} ids */
const idle = (ids) =>
  ids.length > 0 &&
  h("p.warning", { role: "status" }, ids.length === 1 ? `${ids[0]} applies to no one today` : `${ids.length} policies apply to no one today: ${ids.join(", ")}`, ". A name in it may be wrong, or its people come later.");

/** What the ledger says of texts of policies, each asked for once. Whom they apply to, it says of the reader's own organisation. */
class Checks {
  /** @type {Map<string, PolicyCheck | undefined>} */
  #known = new Map();

  /** @param {string} text */
  of(text) {
    if (!this.#known.has(text)) {
      this.#known.set(text, undefined);
      void this.#ask(text);
    }
    return this.#known.get(text);
  }

  /** How much of a text applies to no one of today; empty if all of it applies to a person. @param {string} text */
  unmatched(text) {
    const all = this.of(text)?.policies ?? [];
    const count = all.filter(({ unmatched }) => unmatched).length;
    if (count === 0) return "";
    return count === all.length ? ALL_UNMATCHED : `${count} of ${all.length} apply to no one today`;
  }

  /** @param {string} text */
  async #ask(text) {
    try {
      this.#known.set(text, await query("abac", "check", [text]));
    } catch {
      // Without an answer nothing is said. The text is shown all the same.
    }
    refresh();
  }
}

/** @param {Changes} changes */
function differences({ title, policies }) {
  return h(
    "section",
    { "aria-label": title, role: "status" },
    h("h2", title),
    policies.length === 0 && empty("No text differs."),
    policies.map(({ id, lines }) =>
      h(
        "figure",
        { key: id },
        h("figcaption", id),
        h("pre.diff", { tabindex: 0 }, lines.map(({ kind, text }) => h(`span.${kind}`, SIGNS[kind], text, "\n"))),
      ),
    ),
  );
}

/**
 * @param {string} organisation
 * @param {number} version
 * @returns {Promise<Changes>}
 */
async function changed(organisation, version) {
  const [before, after] = await Promise.all([version > 1 ? texts(organisation, version - 1) : new Map(), texts(organisation, version)]);
  const ids = [...new Set([...before.keys(), ...after.keys()])].sort();
  const policies = ids.map((id) => ({ id, lines: diff(before.get(id) ?? "", after.get(id) ?? "") }));
  return { title: `Set ${version} against the one before`, policies: policies.filter(({ lines }) => lines.some(({ kind }) => kind !== "same")) };
}

/**
 * @param {string} organisation
 * @param {number} version
 * @returns {Promise<Map<string, string>>}
 */
async function texts(organisation, version) {
  /** @type {PolicySet} */
  const set = await query("abac", "policy_set", [organisation, String(version)]);
  return new Map((set.policies ?? []).map(({ id, text = "" }) => [id, text]));
}
