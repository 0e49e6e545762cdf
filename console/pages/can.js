// Whether somebody may do something, and why.

import { query } from "../data/ledger.js";
import { live } from "../data/live.js";
import { h, refresh } from "../view/dom.js";
import { facts, page, rejected, table } from "../view/parts.js";

/** @typedef {import("../answers.js").Decision} Decision */

const ACTIONS = ["acquire", "publish", "subscribe", "override", "confirm", "stop", "resume"];

/** @param {import("../main.js").Visit} visit */
export function open({ parts: [asked = ""], session }) {
  const question = { who: session.id, action: "acquire", service: asked };
  /** @type {Decision | undefined} */
  let answer;
  /** @type {unknown} */
  let error;

  async function ask() {
    answer = error = undefined;
    refresh();
    const { who, action, service } = question;
    try {
      answer = await query("abac", "can", [JSON.stringify({ ...(who && who !== session.id ? { who } : {}), action, service })], true);
    } catch (failed) {
      error = failed;
    }
    refresh();
  }

  const submit = (/** @type {Event} */ event) => {
    event.preventDefault();
    void ask();
  };
  /** @param {"who" | "service"} name */
  const field = (name) => ({ value: question[name], oninput: (/** @type {any} */ event) => void (question[name] = event.target.value) });
  const choose = (/** @type {any} */ event) => void (question.action = event.target.value);

  return {
    show() {
      const names = live.robots?.flatMap((robot) => [robot.Name, ...robot.services.map(({ service }) => service)]) ?? [];
      return page(
        "Can somebody do something?",
        null,
        h(
          "form.ask",
          { onsubmit: submit },
          h("label", "Can", h("input", { placeholder: "ORGANISATION/NAME", ...field("who") })),
          h("label", "do", h("select", { value: question.action, onchange: choose }, ACTIONS.map((name) => h("option", name)))),
          h("label", "on", h("input", { list: "services", required: true, placeholder: "Robot/topic, or a robot", ...field("service") })),
          h("datalist", { id: "services" }, names.map((name) => h("option", { key: name, value: name }))),
          h("button.main", { type: "submit" }, "Ask"),
        ),
        rejected(error),
        answer && decision(answer),
      );
    },
  };
}

/** @param {Decision} decision */
function decision({ who, action, service, allowed, code, reason, found, wanted, next, policies, policy_version: version, conditions }) {
  return h(
    "section",
    { "aria-label": "Answer", role: "status" },
    h(`p.verdict.${allowed ? "yes" : "no"}`, h("b", allowed ? "Yes." : "No."), ` ${who} ${allowed ? "may" : "may not"} ${action} ${service}.`),
    facts(
      !allowed && ["Why", [`${reason} `, h("code", code)]],
      !!found && ["Found", found],
      !!wanted && ["Wanted", wanted],
      !!next && ["Try", next],
      ["Decided by", policies.length ? policies.join(", ") : allowed ? "the owner's rights" : "no policy permits it"],
      version > 0 && ["Set of policies", version],
    ),
    conditions.length > 0 &&
      table(
        "Conditions",
        ["Policy", "Condition", "Found", "Wanted"],
        conditions.map((each) => h("tr", h("td", each.policy), h("td", h("code", each.condition)), h("td", each.found), h("td", each.wanted))),
      ),
  );
}
