// Who may do what with a robot, and why; sharing, and its end.

import { apply, previewShare, previewUnshare, rightsOn, shares } from "../data/access.js";
import { live } from "../data/live.js";
import { h, refresh } from "../view/dom.js";
import { meaningsOf, unknownNames } from "../view/meaning.js";
import { Asked, action, address, atMoment, empty, page, rejected, table } from "../view/parts.js";

/**
 * @typedef {import("../answers.js").Right} Right
 * @typedef {import("../answers.js").PersonRights} PersonRights
 * @typedef {import("../answers.js").Share} Share
 * @typedef {import("../answers.js").ShareTerms} ShareTerms
 * @typedef {import("../answers.js").SharePreview} SharePreview
 * @typedef {import("../answers.js").UnsharePreview} UnsharePreview
 * @typedef {import("../answers.js").RightsDiff} RightsDiff
 */

const EVERY_MS = 15_000;

/** Limits in words, by their names in policies. @type {Record<string, (value: unknown) => string>} */
const LIMITS = {
  max_linear_mm_s: (value) => `at most ${Number(value) / 1000} m/s`,
  max_angular_mrad_s: (value) => `at most ${Number(value) / 1000} rad/s`,
  max_rate_mhz: (value) => `at most ${Number(value) / 1000} messages a second`,
  max_age_ms: (value) => `at most ${value} ms old`,
  between: (value) => `within ${/** @type {string[]} */ (value).join(" and ")}`,
};

/** @param {Record<string, unknown> | undefined} limits */
const limitsOf = (limits = {}) => Object.entries(limits).map(([name, value]) => LIMITS[name]?.(value) ?? `${name} ${value}`).join(", ");

/** @param {import("../main.js").Visit} visit */
export function open({ parts: [asked = ""], identity, session }) {
  /** @type {Asked<{ people: PersonRights[], isWhole: boolean }> | undefined} */
  let rights;
  let of = "";
  /** @type {Asked<Share[]>} */
  const shared = new Asked(shares, EVERY_MS);
  /** @type {{ ends: false, preview: SharePreview } | { ends: true, preview: UnsharePreview } | undefined} */
  let shown;
  let expects = false;
  /** @type {unknown} */
  let error;
  /** @type {Record<string, string>} */
  let terms = {};
  const failed = (/** @type {unknown} */ found) => void (error = found);

  /** The robot of the page: the one of the address, or the first one of the own organisation. */
  function robot() {
    const all = live.robots ?? [];
    return all.find(({ Name }) => Name === asked) ?? (asked ? undefined : (all.find(({ organisation }) => organisation === identity.organisation) ?? all[0]));
  }

  async function preview() {
    shown = undefined;
    expects = false;
    shown = { ends: false, preview: await previewShare(given(terms, robot()?.Name ?? "")) };
  }

  const end = (/** @type {string} */ id) => async () => {
    shown = undefined;
    shown = { ends: true, preview: await previewUnshare(id) };
  };

  async function put() {
    await apply(identity, shown?.preview.set);
    shown = undefined;
    terms = {};
    await Promise.all([shared.again(), rights?.again()]);
  }

  const submit = (/** @type {Event} */ event) => {
    event.preventDefault();
    error = undefined;
    void preview().catch(failed).finally(refresh);
  };

  /** @param {string} name @param {string} label @param {Record<string, any>} [more] */
  const field = (name, label, more = {}) =>
    h("label", { key: name }, label, h("input", { name, value: terms[name] ?? "", oninput: (/** @type {any} */ event) => void (terms[name] = event.target.value), ...more }));

  /** @param {import("../answers.js").Robot} robot */
  const form = ({ Name, services }) =>
    h(
      "form.ask",
      { onsubmit: submit, "aria-label": `Share ${Name}` },
      field("with", "With", { required: true, placeholder: "Org1, or Org1/Salma" }),
      h(
        "label",
        { key: "resource" },
        "What",
        h(
          "select",
          { name: "resource", value: terms["resource"] ?? Name, onchange: (/** @type {any} */ event) => void (terms["resource"] = event.target.value) },
          [Name, ...services.map(({ service }) => service)].map((name) => h("option", { key: name, value: name }, name)),
        ),
      ),
      field("attribute", "Only with attribute", { placeholder: "guest" }),
      field("from", "From", { type: "datetime-local" }),
      field("until", "Until", { type: "datetime-local" }),
      field("begins", "Daily from", { type: "time" }),
      field("closes", "Daily until", { type: "time" }),
      field("max_linear", "At most, m/s", { inputmode: "decimal", placeholder: "0.3" }),
      field("max_angular", "At most, rad/s", { inputmode: "decimal", placeholder: "0.5" }),
      field("rate", "At most, messages a second", { inputmode: "numeric", placeholder: "20" }),
      field("priority", "Priority", { inputmode: "numeric", placeholder: "0" }),
      h(
        "label.check",
        { key: "read_only" },
        h("input", { type: "checkbox", name: "read_only", checked: terms["read_only"] === "yes", onchange: (/** @type {any} */ event) => void (terms["read_only"] = event.target.checked ? "yes" : "") }),
        " Only read",
      ),
      h("button.main", { key: "preview", type: "submit" }, "Preview"),
    );

  /** What sharing or its end would change, before it does. */
  function consequences() {
    if (!shown) return null;
    const { preview, ends } = shown;
    const unknown = shown.ends ? [] : shown.preview.unknown;
    const replaces = !shown.ends && shown.preview.replaces;
    return h(
      "section.preview",
      { key: `preview ${preview.id}`, "aria-label": "Preview" },
      h("h2", ends ? `End ${preview.id}` : `Share as ${preview.id}`),
      replaces && h("p.warning", `It replaces ${replaces}.`),
      !shown.ends && meaningsOf(shown.preview.meaning),
      !shown.ends && shown.preview.keeps_built_in && h("p.dim", "The built-in policy stays in force with it."),
      unknownNames(unknown),
      unknown.length > 0 &&
        h("label.check", h("input", { type: "checkbox", checked: expects, onchange: (/** @type {any} */ event) => ((expects = event.target.checked), refresh()) }), " The name comes later"),
      changesOf(preview.diff),
      shown.ends && shown.preview.still.length > 0 && [h("h3", "Who still may"), people("Who still may", shown.preview.still)],
      h("details", h("summary", "The policy in Cedar"), h("pre", { tabindex: 0 }, preview.text)),
      h(
        "div.actions",
        h("button.plain", { key: "cancel", type: "button", onclick: () => ((shown = undefined), refresh()) }, "Cancel"),
        action("apply", { kind: ends ? "danger" : "main", run: put, failed, disabled: unknown.length > 0 && !expects }, ends ? "End sharing" : "Share"),
      ),
    );
  }

  return {
    end() {
      rights?.end();
      shared.end();
    },
    show() {
      const found = robot();
      const all = live.robots ?? [];
      if (!found) return page("Access", null, live.robots && empty(asked ? `There is no robot ${asked}.` : "There is no robot."));
      const { Name, organisation } = found;
      if (of !== Name) {
        rights?.end();
        [of, shown, error] = [Name, undefined, undefined];
        rights = new Asked(() => rightsOn(Name), EVERY_MS);
      }
      const mayShare = session.role === "admin" && identity.organisation === organisation;
      const own = shared.answer?.filter(({ resource = "", id }) => (resource.split("/")[0] || id.split("-")[1]) === Name) ?? [];
      return page(
        "Access",
        h("a", { href: address("can", Name) }, "May a person do something, and why?"),
        h(
          "label.search",
          "Robot",
          h("select", { value: Name, onchange: (/** @type {any} */ event) => void (location.hash = address("access", event.target.value)) }, all.map((each) => h("option", { key: each.Name, value: each.Name }, each.Name))),
        ),
        h("h2", `Who may do what with ${Name}`),
        rejected(rights?.error),
        rights?.answer && [
          rights.answer.people.length === 0 && empty("No one whom the ledger lists."),
          rights.answer.people.length > 0 && people(`Who may do what with ${Name}`, rights.answer.people),
          h("p.dim", note(session.role, identity.organisation, organisation), !rights.answer.isWhole && " The list is a part: there are more people."),
        ],
        h("h2", "Shares"),
        rejected(shared.error),
        shared.answer && own.length === 0 && empty(`${Name} is shared by no share. Policies of ${organisation} may permit more: see the list above.`),
        own.length > 0 &&
          table(
            `Shares of ${Name}`,
            ["Share", "With", "What", "Terms", ""],
            own.map((share) =>
              h(
                "tr",
                { key: share.id },
                h("td", share.id),
                h("td", share.with ?? ""),
                h("td", share.resource ?? ""),
                h("td.wide", share.edited ? "edited by hand: see Policies" : termsOf(share)),
                h("td", mayShare && action(`end ${share.id}`, { run: end(share.id), failed }, "End…", h("span.unseen", ` ${share.id}`))),
              ),
            ),
          ),
        mayShare && [h("h2", `Share ${Name}`), form(found)],
        rejected(error),
        consequences(),
      );
    },
  };
}

/** Whom the list shows. @param {string} role @param {string} own @param {string} owner */
function note(role, own, owner) {
  if (role !== "admin") return "You see your own rights. Admins see those of their organisation, and the owner's all.";
  return own === owner ? "People of every organisation, as far as the ledger lists them." : `People of ${own}. The owner, ${owner}, sees those of every organisation.`;
}

/**
 * The terms as the ledger takes them.
 * @param {Record<string, string>} typed
 * @param {string} robot
 * @returns {ShareTerms}
 */
export function given(typed, robot) {
  const { resource = robot, attribute = "", begins = "", closes = "", from = "", until = "", read_only: readOnly } = typed;
  const moment = (/** @type {string} */ text) => (text ? new Date(text).getTime() * 1000 : undefined);
  /** @type {Record<string, unknown>} */
  const terms = {
    resource,
    with: typed["with"]?.trim(),
    attribute: attribute.trim() && (attribute.includes("=") ? attribute.trim() : `${attribute.trim()}=true`),
    from: moment(from),
    until: moment(until),
    hours: begins && closes ? `${begins}-${closes} ${offset(new Date())}` : undefined,
    read_only: readOnly === "yes" || undefined,
  };
  for (const name of ["max_linear", "max_angular", "rate", "priority"]) terms[name] = typed[name]?.trim();
  return /** @type {any} */ (Object.fromEntries(Object.entries(terms).filter(([, value]) => value !== undefined && value !== "")));
}

/** The zone of this browser: +01:00. @param {Date} at */
function offset(at) {
  const minutes = -at.getTimezoneOffset();
  const two = (/** @type {number} */ number) => String(number).padStart(2, "0");
  return `${minutes < 0 ? "-" : "+"}${two(Math.floor(Math.abs(minutes) / 60))}:${two(Math.abs(minutes) % 60)}`;
}

/** @param {Share} share */
function termsOf({ attribute, from, until, hours, max_linear: linear, max_angular: angular, rate, priority, read_only: readOnly }) {
  /** @type {(import("../view/dom.js").Child)[]} */
  const terms = [
    readOnly && "only read",
    attribute && `with ${attribute}`,
    from && ["from ", atMoment(from)],
    until && ["until ", atMoment(until)],
    hours && `daily ${hours}`,
    linear && `at most ${linear} m/s`,
    angular && `at most ${angular} rad/s`,
    rate && `at most ${rate} messages a second`,
    priority && `priority ${priority}`,
  ];
  return terms.filter(Boolean).map((term, at) => [at > 0 && ", ", term]);
}

/** Rights with the same reason are one line. @param {Right[]} rights */
function grouped(rights) {
  /** @type {Map<string, Right & { actions: string[] }>} */
  const found = new Map();
  for (const right of rights) {
    const key = JSON.stringify([right.of, right.policies, right.rule, right.limits, right.closed]);
    const known = found.get(key) ?? { ...right, actions: [] };
    known.actions.push(right.action);
    found.set(key, known);
  }
  return [...found.values()];
}

/** @param {string} label @param {PersonRights[]} all */
const people = (label, all) =>
  table(
    label,
    ["Who", "Role", "May"],
    all.map(({ who, role, rights }) =>
      h(
        "tr",
        { key: who },
        h("td", who),
        h("td", role),
        h(
          "td.wide",
          rights.length === 0 && h("span.dim", "nothing"),
          h(
            "ul.happened",
            grouped(rights).map(({ of, actions, policies, rule, limits = {}, closed = [] }) =>
              h(
                "li",
                h("b", actions.join(", ")),
                ` ${of}`,
                Object.keys(limits).length > 0 && `, ${limitsOf(limits)}`,
                closed.length > 0 && [" ", h("span.what.warn", "closed now")],
                h("span.dim", rule ? ` — as ${rule}` : ` — by ${policies.join(", ")}`),
              ),
            ),
          ),
        ),
      ),
    ),
  );

/** @param {RightsDiff} diff */
function changesOf({ gained = [], lost = [], limited = [], incomplete = false }) {
  const line = (/** @type {{ who: string, of: string, action: string }} */ { who, of, action: what }) => `${who}: ${what} ${of}`;
  return [
    gained.length === 0 && lost.length === 0 && limited.length === 0 && h("p.dim", "No one of today may do more or less."),
    gained.length > 0 && [h("h3", "Who may more"), h("ul", gained.map((each) => h("li", line(each), each.limits && `, ${limitsOf(each.limits)}`)))],
    lost.length > 0 && [h("h3", "Who may no longer"), h("ul", lost.map((each) => h("li", line(each))))],
    limited.length > 0 && [h("h3", "Whose limits change"), h("ul", limited.map((each) => h("li", line(each), `: ${limitsOf(each.before) || "no limit"} → ${limitsOf(each.after) || "no limit"}`)))],
    incomplete && h("p.warning", "There are too many people to ask about all: these lists are a part."),
  ];
}
