// One robot: its holders and queues, the flow of its messages, and the actions on it.

import { clock, moment } from "../data/bytes.js";
import { Rejection, rejectionOf } from "../data/api.js";
import { invoke, openStops, query } from "../data/ledger.js";
import { live, readRobots } from "../data/live.js";
import { h, refresh } from "../view/dom.js";
import { Asked, action, address, empty, facts, page, rejected, remaining, table } from "../view/parts.js";
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
const AGAIN_MS = 1000;

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

  /** Signs and sends the stop again until it is in force, or the page is left. @param {...string} args */
  const stop = (...args) => async () => {
    for (;;) {
      try {
        await invoke(identity, "abac", "stop", ...args);
        break;
      } catch (found) {
        const rejection = rejectionOf(found);
        const isOpen = rejection.status === 0 || /^LGR-(4|1006|1007)/.test(rejection.code);
        if (!isOpen) throw found;
        const message = hasEnded ? "The stop is not in force: repeat it" : "The stop is not in force yet";
        const next = "stay on this page: the stop is signed and sent again until it is in force";
        failed(new Rejection({ message, code: rejection.code, found: rejection.message, next }));
        if (hasEnded) return;
        refresh();
        await new Promise((done) => setTimeout(done, AGAIN_MS));
      }
    }
    failed(undefined);
    reason = "";
    await readRobots();
  };

  /** Also cancels the stops of the robot that have no verdict. */
  const resume = async () => {
    const open = await openStops(name);
    await invoke(identity, "abac", "resume", name, ...(open.length ? [reason, ...open] : []));
    reason = "";
    await readRobots();
  };

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
      service.side_door && h("p.warning", `Since ${moment(service.side_door.since)}, others publish on ${service.side_door.topic} around the ledger.`),
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
        !holds && !waits && action(`acquire ${id}`, { kind: "main", run: act("acquire", id), failed, disabled: isStopped }, "Acquire"),
        holds && action(`renew ${id}`, { run: act("renew", id), failed }, "Renew"),
        (holds || waits) && action(`release ${id}`, { run: act("release", id), failed }, holds ? "Release" : "Leave the queue"),
        !holds && action(`take ${id}`, { kind: "danger", run: act("take", id, reason || "taken in the console"), failed, disabled: isStopped }, "Take"),
      ),
      queue && queue.line.length > 0 && table(`Queue of ${id}`, ["Position", "Contender", "Priority", "Since", "Expected"], queue.line.map(place)),
    ];
  }

  return {
    end() {
      hasEnded = true;
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
        facts(
          ["Owner", robot.organisation],
          ["Requires", robot.attribute_required],
          stopped && ["Stopped", `by ${stopped.by} at ${clock(stopped.since)}${stopped.reason && `: ${stopped.reason}`}`],
        ),
        h(
          "div.actions",
          stopped
            ? action("resume", { kind: "main", run: resume, failed }, "Resume")
            : action("stop", { kind: "danger", run: stop(name, ...(reason ? [reason] : [])), failed }, "Stop"),
          h(
            "label",
            h("span", "Reason"),
            h("input", { value: reason, maxlength: 200, placeholder: "why, for the others", oninput: (/** @type {any} */ event) => void (reason = event.target.value) }),
          ),
        ),
        rejected(error),
        robot.services.map((service) => section(service, stopped !== undefined)),
        h("h2", "Lately"),
        entries(about.slice(0, LATELY)),
      );
    },
  };
}

/** @param {Queue["line"][number]} position */
function place({ position, contender, priority, since, expected }) {
  return h("tr", { key: contender }, h("td", position), h("td", contender), h("td", priority), h("td", clock(since)), h("td", expected ? clock(expected) : ""));
}
