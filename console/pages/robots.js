// All robots, live.

import { live } from "../data/live.js";
import { stop } from "../data/stop.js";
import { h, refresh } from "../view/dom.js";
import { action, address, empty, page, rejected, remaining } from "../view/parts.js";

/**
 * @typedef {import("../answers.js").Robot} Robot
 * @typedef {import("../answers.js").Service} Service
 * @typedef {"stopped" | "held" | "free"} State
 */

const TICK_MS = 500;

/** @param {Robot} robot @returns {State} */
export function stateOf(robot) {
  if (robot.stopped) return "stopped";
  return robot.services.some(({ direction, holders }) => direction === "command" && holders.length > 0) ? "held" : "free";
}

/** @param {Robot} robot */
export const mark = (robot) => h(`span.mark.${stateOf(robot)}`, stateOf(robot));

/** @param {import("../main.js").Visit} visit */
export function open({ identity }) {
  let search = "";
  let isOver = false;
  /** @type {unknown} */
  let error;
  const failed = (/** @type {unknown} */ found) => {
    error = found;
    refresh();
  };
  const stops = (/** @type {string} */ name) => () => stop(identity, name, "", { isOver: () => isOver, delayed: failed });
  const timer = setInterval(refresh, TICK_MS);
  const field = () =>
    h(
      "label.search",
      h("span.unseen", "Search robots"),
      h("input", { type: "search", placeholder: "Search", value: search, oninput: (/** @type {any} */ event) => ((search = event.target.value), refresh()) }),
    );
  return {
    end() {
      isOver = true;
      clearInterval(timer);
    },
    show() {
      const all = live.robots;
      const words = search.toLowerCase();
      const shown = all?.filter((robot) => `${robot.Name} ${robot.organisation}`.toLowerCase().includes(words));
      const count = (/** @type {State} */ state) => h("b", all?.filter((robot) => stateOf(robot) === state).length);
      return page(
        "Robots",
        field(),
        all && h("p.summary", all.length, " robots · ", count("held"), " held · ", count("stopped"), " stopped · ", count("free"), " free"),
        all?.length === 0 && empty("There is no robot. Its owner registers one: ledgerctl robot add"),
        rejected(error),
        h("ul.map", shown?.map((robot) => card(robot, action(`stop ${robot.Name}`, { kind: "danger", run: stops(robot.Name), failed }, "Stop", h("span.unseen", ` ${robot.Name}`))))),
      );
    },
  };
}

/**
 * A robot. The button stays where it is, whatever happens to the robot.
 * @param {Robot} robot
 * @param {import("../view/dom.js").Child} button
 */
function card(robot, button) {
  const { stopped } = robot;
  return h(
    "li",
    { key: robot.Name, class: stateOf(robot) },
    h("div.title", h("a", { href: address("robots", robot.Name) }, robot.Name), mark(robot), button),
    h("p.dim", robot.organisation),
    stopped && h("p.note", "by ", stopped.by, stopped.reason && `: ${stopped.reason}`),
    h(
      "ul.services",
      robot.services.map((service) =>
        h("li", { key: service.service }, h("span.topic", service.topic), h("span.rule", service.mode), holder(service)),
      ),
    ),
  );
}

/** @param {Service} service */
function holder({ holders: [first, ...others], waiting, direction, expires }) {
  const queue = waiting ? ` · ${waiting} in the queue` : "";
  if (!first) return h("span.dim", direction === "feed" ? "feed" : `not held${queue}`);
  return h("span.holder", first, others.length > 0 && ` and ${others.length} more`, " · ", remaining(expires), queue);
}
