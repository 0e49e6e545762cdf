// Policies: those in force, their history, and how two sets differ.

import { moment } from "../data/bytes.js";
import { diff } from "../data/diff.js";
import { list, query } from "../data/ledger.js";
import { live } from "../data/live.js";
import { h } from "../view/dom.js";
import { Asked, action, address, empty, page, rejected, table } from "../view/parts.js";

/**
 * @typedef {import("../answers.js").Policy} Policy
 * @typedef {import("../answers.js").PolicySet} PolicySet
 * @typedef {{ title: string, policies: { id: string, lines: import("../data/diff.js").Line[] }[] }} Changes
 */

const EVERY_MS = 5000;
// So few policies are shown open.
const OPEN_MAX = 3;
const SIGNS = { same: "  ", gone: "- ", new: "+ " };

/** @param {import("../main.js").Visit} visit */
export function open({ parts: [chosen], identity }) {
  const organisation = chosen || identity.organisation;
  /** @type {Asked<Policy[]>} */
  const policies = new Asked(() => list("abac", "policies"), EVERY_MS);
  /** @type {Asked<PolicySet[]>} */
  const sets = new Asked(() => query("abac", "policy_history", [organisation]), EVERY_MS);
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
      h("td", moment(time)),
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
        h("a", { href: address("can", "") }, "Can somebody do something?"),
        h("div.tabs", { role: "group", "aria-label": "Organisations" }, [...organisations].sort().map(tab)),
        rejected(policies.error),
        h("h2", "In force"),
        policies.answer && theirs.length === 0 && h("p.dim", `${organisation} has no policies of its own. The default decides.`),
        shown.map(({ id, text }) =>
          h("details", { key: id, open: shown.length <= OPEN_MAX }, h("summary", id), h("pre", { tabindex: 0 }, text)),
        ),
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
