// One robot: its holders and queues, the flow of its messages, and the actions on it.

import { invoke, openStops, query } from "../data/ledger.js";
import { live, readRobots } from "../data/live.js";
import { stop } from "../data/stop.js";
import { h, refresh } from "../view/dom.js";
import { Asked, action, address, atMoment, atTime, empty, facts, page, rejected, remaining, table } from "../view/parts.js";
import { Question } from "../view/question.js";
import { entries } from "./feed.js";
import { Flow } from "./flow.js";
import { mark } from "./robots.js";

/**
 * @typedef {import("../answers.js").Service} Service
 * @typedef {import("../answers.js").Queue} Queue
 * @typedef {import("../main.js").Visit} Visit
 * @typedef {(what: string, ...args: string[]) => () => Promise<void>} Act
 */

const TICK_MS = 500;
const QUEUE_MS = 5000;
const LATELY = 20;

/** A service as it is shown: its queue, which is asked for again when its record changes, and its messages. */
class Shown {
  /** @param {Service} service */
  constructor({ service, type, epoch, waiting }) {
    /** @type {Asked<Queue>} */
    this.queue = new Asked(() => query("abac", "line", [service]), QUEUE_MS);
    this.flow = new Flow(service, type);
    this.record = `${epoch}/${waiting}`;
  }

  /** @param {Service} service */
  update({ epoch, waiting }) {
    const record = `${epoch}/${waiting}`;
    if (record !== this.record) void this.queue.again();
    this.record = record;
  }

  end() {
    this.queue.end();
    this.flow.end();
  }
}

/** @param {Visit} visit */
export function open({ parts: [name = ""], identity, session }) {
  const timer = setInterval(refresh, TICK_MS);
  /** @type {Map<string, Shown>} */
  const shown = new Map();
  const question = new Question();
  let reason = "";
  let hasEnded = false;
  /** @type {unknown} */
  let error;
  const failed = (/** @type {unknown} */ found) => void (error = found);
  /** @type {Act} */
  const act = (what, ...args) => async () => {
    await invoke(identity, "abac", what, ...args);
    reason = "";
    await readRobots();
  };

  const stops = async () => {
    await stop(identity, name, reason, { isOver: () => hasEnded, delayed: (found) => (failed(found), refresh()) });
    reason = "";
  };

  /** Also cancels the stops of the robot that have no verdict. @param {string} why */
  const resume = async (why) => {
    await invoke(identity, "abac", "resume", name, why, ...(await openStops(name)));
    await readRobots();
  };

  /** @param {Service} service */
  const overrides = ({ service: id, holders }) => ({
    title: `Override ${id}?`,
    about: holders.length ? `Takes it from ${holders.join(", ")}, whose commands end at once.` : "No one holds it. Acquire is enough, unless policies deny it.",
    confirm: "Override",
    run: async (/** @type {string} */ why) => {
      await invoke(identity, "abac", "take", id, why);
      await readRobots();
    },
  });

  /** @param {Service} service @param {boolean} isStopped */
  function section(service, isStopped) {
    const known = shown.get(service.service) ?? new Shown(service);
    shown.set(service.service, known);
    known.update(service);
    return h(
      "section",
      { key: service.service, "aria-label": service.service },
      h("div.head", h("h2", service.topic), h("span.dim", `${service.type} · ${service.mode} · ${service.direction}`)),
      service.direction === "command" && control(service, known.queue.answer, isStopped),
      service.side_door && h("p.warning", "Since ", atMoment(service.side_door.since), `, others publish on ${service.side_door.topic} around the ledger.`),
      known.flow.show(),
      h("p.dim", h("a", { href: address("can", service.service) }, "Who may use it, and why?")),
    );
  }

  /** @param {Service} service @param {Queue | undefined} queue @param {boolean} isStopped */
  function control(service, queue, isStopped) {
    const id = service.service;
    const holds = service.holders.includes(session.id);
    const waits = queue?.line.some(({ contender }) => contender === session.id) ?? false;
    return [
      h("p", service.holders.length ? ["Held by ", h("b", service.holders.join(", ")), `, epoch ${service.epoch}, `, remaining(service.expires)] : "Not held."),
      h(
        "div.actions",
        // Each button stays where it is: the second click of a double click does the same as the first one, or nothing.
        action(`acquire ${id}`, { kind: "main", run: act("acquire", id), failed, disabled: isStopped || holds || waits }, "Acquire"),
        action(`renew ${id}`, { run: act("renew", id), failed, disabled: !holds }, "Renew"),
        action(`release ${id}`, { run: act("release", id), failed, disabled: !holds && !waits }, waits ? "Leave the queue" : "Release"),
        h("button.danger", { key: `override ${id}`, type: "button", disabled: isStopped || holds, onclick: question.asks(overrides(service)) }, "Override…"),
      ),
      queue && queue.line.length > 0 && table(`Queue of ${id}`, ["Position", "Contender", "Priority", "Since", "Expected"], queue.line.map(place)),
    ];
  }

  /** @param {NonNullable<import("../answers.js").Robot["stopped"]>} stopped */
  const stoppage = ({ by, since, reason: why }) =>
    h(
      "section",
      { key: "stopped", "aria-label": "Stopped" },
      h("p.warning", h("strong", "Stopped"), ` by ${by} at `, atTime(since), why && `: ${why}`),
      h("div.actions", h("button.plain", { key: "resume", type: "button", onclick: question.asks({ title: `Resume ${name}?`, about: `Stopped by ${by}${why && `: ${why}`}. The next contender in a queue gets it, and it may move at once. Grants that the stop ended do not come back: acquire again.`, confirm: "Resume", run: resume }) }, "Resume…")),
    );

  return {
    end() {
      hasEnded = true;
      question.end();
      clearInterval(timer);
      for (const each of shown.values()) each.end();
    },
    show() {
      const robot = live.robots?.find((each) => each.Name === name);
      if (!robot) return page(name, null, live.robots && empty(`There is no robot ${name}.`));
      const { stopped } = robot;
      const about = live.feed.filter(({ subject }) => subject === name || subject.startsWith(`${name}/`));
      return page(
        name,
        mark(robot),
        // First, and always at this place: one click, whatever the robot's state is.
        h(
          "div.actions.stops",
          action("stop", { kind: "danger", run: stops, failed }, "Stop"),
          h(
            "label",
            h("span", "Reason"),
            h("input", { value: reason, maxlength: 200, placeholder: "why, for the others", oninput: (/** @type {any} */ event) => void (reason = event.target.value) }),
          ),
        ),
        facts(["Owner", robot.organisation], ["Requires", robot.attribute_required]),
        stopped && stoppage(stopped),
        h("p.dim", h("a", { href: address("access", name) }, "Who may do what"), " · ", h("a", { href: address("tasks", name) }, "Tasks")),
        rejected(error),
        robot.services.map((service) => section(service, stopped !== undefined)),
        h("h2", "Lately"),
        entries(about.slice(0, LATELY)),
        question.show(),
      );
    },
  };
}

/** @param {Queue["line"][number]} position */
function place({ position, contender, priority, since, expected }) {
  return h("tr", { key: contender }, h("td", position), h("td", contender), h("td", priority), h("td", atTime(since)), h("td", expected ? atTime(expected) : ""));
}
