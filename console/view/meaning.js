// Policies in words.

import { h } from "./dom.js";

/**
 * @typedef {import("../answers.js").Meaning} Meaning
 * @typedef {import("../answers.js").UnknownName} UnknownName
 */

/** Marks a policy that applies to no one of today. @param {Meaning} meaning */
const unmatched = (meaning) => meaning.unmatched && [" ", h("span.what.warn", "applies to no one today")];

/** @param {Meaning[]} meanings */
export const meaningsOf = (meanings) =>
  h(
    "ul.meanings",
    meanings.map((meaning) =>
      h(
        "li",
        h("b", meaning.effect),
        ` ${meaning.meaning}`,
        meaning.when.length > 0 && `, when ${meaning.when.join(" and ")}`,
        meaning.limits.length > 0 && `, ${meaning.limits.join(", ")}`,
        unmatched(meaning),
        meaning.except.length > 0 && h("span.dim", ` — without ${meaning.except.join(", ")}${meaning.effect === "permit" ? ": a permit must name these actions" : " by the robot and by holders: a forbid must name these actions"}`),
      ),
    ),
  );

/** @param {UnknownName[]} names */
export const unknownNames = (names) =>
  names.map(({ line, kind, name, near }) => h("p.warning", { key: `${line} ${kind} ${name}` }, `Line ${line} names ${kind} `, h("code", name), `, which does not exist${near ? `; ${near}` : ""}.`));
