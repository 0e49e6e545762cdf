// The identities of the own organisation, and when their certificates end.

import { span } from "../data/bytes.js";
import { endOf, idOf } from "../data/identity.js";
import { list, now } from "../data/ledger.js";
import { abandon } from "../data/session.js";
import { h } from "../view/dom.js";
import { Asked, action, facts, onDay, page, rejected, table } from "../view/parts.js";

/** @typedef {import("../answers.js").Registered} Registered */

const EVERY_MS = 10_000;
const SOON = 30 * 86400e6;

/** @param {import("../main.js").Visit} visit */
export function open({ identity, session }) {
  /** @type {Asked<Registered[]>} */
  const asked = new Asked(() => list("msp", "identities"), EVERY_MS);
  /** @type {unknown} */
  let error;
  const failed = (/** @type {unknown} */ found) => void (error = found);
  const forget = async () => {
    if (!confirm("Forget the key of this browser? It needs a new link then.")) return;
    await abandon();
    location.hash = "#/";
    location.reload();
  };
  return {
    end: () => asked.end(),
    show: () =>
      page(
        "Identities",
        null,
        h(
          "section",
          { "aria-label": "This browser" },
          h("h2", "This browser"),
          facts(
            ["Identity", idOf(identity)],
            ["Role", session.role],
            ["Attributes", Object.entries(session.attributes).map(([key, value]) => `${key}=${value}`).join(", ") || "none"],
            ["Certificate ends", ends(endOf(identity))],
            ["Key", "P-256, kept by this browser, and cannot be read by any page"],
          ),
          h("p.dim", `Before its certificate ends, an admin gives it a new link: ledgerctl console ${identity.name} --reissue`),
          h("div.actions", action("forget", { kind: "danger", run: forget, failed }, "Forget this identity")),
          rejected(error),
        ),
        h("h2", identity.organisation),
        rejected(asked.error),
        asked.answer && table(`Identities of ${identity.organisation}`, ["Name", "Role", "State", "Certificate ends", "Attributes", "Registered by"], asked.answer.map(row)),
      ),
  };
}

/** @param {Registered} person */
function row(person) {
  const attributes = Object.entries(person.attributes).map(([key, value]) => (value === "true" ? key : `${key}=${value}`));
  return h(
    "tr",
    { key: person.name },
    h("td", person.name),
    h("td", person.role),
    h("td", stateOf(person)),
    h("td", ends(Math.max(0, ...valid(person).map((each) => each.not_after)))),
    h("td.wide", attributes.join(", ")),
    h("td", person.by),
  );
}

/** @param {Registered} person */
const valid = (person) => person.certificates.filter((each) => !each.revoked && each.not_after > now());

/** @param {Registered} person */
function stateOf(person) {
  if (valid(person).length > 0) return h("span.what.good", "enrolled");
  if (person.certificates.some((each) => each.revoked)) return h("span.what.bad", "revoked");
  if (person.certificates.length > 0) return h("span.what.warn", "ended");
  return h("span.what", person.secret && person.secret.expires > now() ? "may enrol" : "never enrolled");
}

/** @param {number} at */
function ends(at) {
  if (!at) return null;
  const left = at - now();
  return h("span", { class: left < SOON ? "soon" : undefined }, onDay(at), " ", h("span.dim", `in ${span(left)}`));
}
