// Who may do what with a robot, and shares: docs/policies.md.

import { invoke, query } from "./ledger.js";

/**
 * @typedef {import("../answers.js").PersonRights} PersonRights
 * @typedef {import("../answers.js").ShareTerms} ShareTerms
 * @typedef {import("../answers.js").Share} Share
 * @typedef {import("../answers.js").SharePreview} SharePreview
 * @typedef {import("../answers.js").UnsharePreview} UnsharePreview
 */

// Most pages of people.
const PAGES_MAX = 64;

/**
 * All people with rights on a robot, as far as the reader may see them.
 * @param {string} robot
 * @returns {Promise<{ people: PersonRights[], isWhole: boolean }>}
 */
export async function rightsOn(robot) {
  /** @type {PersonRights[]} */
  const people = [];
  /** @type {string | undefined} */
  let after;
  for (let page = 0; page < PAGES_MAX; page += 1) {
    /** @type {{ items: PersonRights[], next?: string }} */
    const answer = await query("abac", "access", [JSON.stringify({ robot }), JSON.stringify({ after })]);
    people.push(...answer.items);
    after = answer.next;
    if (after === undefined) return { people, isWhole: true };
  }
  return { people, isWhole: false };
}

/** @returns {Promise<Share[]>} */
export const shares = () => query("abac", "shares");

/** @param {ShareTerms} terms @returns {Promise<SharePreview>} */
export const previewShare = (terms) => query("abac", "share_preview", [JSON.stringify(terms)], true);

/** @param {string} id @returns {Promise<UnsharePreview>} */
export const previewUnshare = (id) => query("abac", "unshare_preview", [id], true);

/**
 * Puts the policies of a preview in force.
 * @param {import("./identity.js").Identity} identity
 * @param {unknown} set
 */
export const apply = (identity, set) => invoke(identity, "abac", "policy", "apply", JSON.stringify(set));
