// Tasks: those that are open, by robot, and those that ended lately.

import { list, now, query } from "../data/ledger.js";
import { live } from "../data/live.js";
import { h } from "../view/dom.js";
import { Asked, address, atTime, empty, page, rejected, remaining, table } from "../view/parts.js";

/**
 * @typedef {import("../answers.js").Task} Task
 * @typedef {import("../answers.js").Queue} Queue
 * @typedef {Map<number, Queue["line"][number]>} Positions
 */

const EVERY_MS = 3000;
const ENDED_MAX = 30;
const OPEN = ["running", "waiting", "scheduled"];

/** @type {Record<string, string>} */
const TONES = { running: "good", done: "good", failed: "bad", expired: "warn", preempted: "warn" };

/** The tasks, and the positions of those that wait. */
async function read() {
  /** @type {Task[]} */
  const tasks = await list("abac", "tasks");
  const services = new Set(tasks.filter(({ state }) => state === "waiting").map(({ service }) => service));
  /** @type {Queue[]} */
  const queues = await Promise.all([...services].map((service) => query("abac", "line", [service])));
  /** @type {Positions} */
  const positions = new Map();
  for (const position of queues.flatMap(({ line }) => line)) if (position.task !== undefined) positions.set(position.task, position);
  return { tasks, positions };
}

/** @param {import("../main.js").Visit} visit */
export function open({ parts: [robot = ""] }) {
  /** @type {Asked<{ tasks: Task[], positions: Positions }>} */
  const asked = new Asked(read, EVERY_MS);
  return {
    end: () => asked.end(),
    show() {
      const { answer, error } = asked;
      const all = answer?.tasks.filter(({ service }) => !robot || robotOf(service) === robot) ?? [];
      const isOpen = (/** @type {Task} */ { state }) => OPEN.includes(state);
      const opened = all.filter(isOpen).sort(byTurn);
      const ended = all.filter((task) => !isOpen(task)).sort((one, other) => (other.ended ?? 0) - (one.ended ?? 0));
      const robots = [...new Set(opened.map(({ service }) => robotOf(service)))].sort();
      return page(
        "Tasks",
        robot && h("a", { href: address("tasks") }, "All robots"),
        rejected(error),
        answer && h("p.summary", h("b", opened.length), " open · ", h("b", opened.filter(({ state }) => state === "running").length), " running"),
        answer && opened.length === 0 && empty(robot ? `No open task of ${robot}.` : "No open task. One begins with: ledgerctl task submit ROBOT/TOPIC"),
        robots.map((name) => [
          h("h2", { key: name }, h("a", { href: address("robots", name) }, name), live.robots?.some((each) => each.Name === name && each.stopped) && [" ", h("span.mark.stopped", "stopped")]),
          table(
            `Open tasks of ${name}`,
            ["Task", "State", "Contender", "Topic", "Progress", "Priority", "Turn", "Deadline", "Submitted"],
            opened.filter(({ service }) => robotOf(service) === name).map((task) => row(task, answer?.positions.get(task.id))),
          ),
        ]),
        ended.length > 0 && [
          h("h2", "Ended lately"),
          table("Tasks that ended", ["Task", "State", "Contender", "Service", "Progress", "Ended", "Reason"], ended.slice(0, ENDED_MAX).map(endedRow)),
        ],
      );
    },
  };
}

/** @param {string} service */
const robotOf = (service) => service.split("/")[0] ?? "";

/** Those that run first, then those that wait by priority and time. @param {Task} one @param {Task} other */
const byTurn = (one, other) => OPEN.indexOf(one.state) - OPEN.indexOf(other.state) || other.priority - one.priority || one.submitted - other.submitted;

/** @param {Task} task */
const state = ({ state }) => h("span.what", { class: TONES[state] }, state);

/** @param {Task} task */
const progress = ({ id, reached, total }) => [h("progress", { max: total, value: reached, "aria-label": `Points reached of task ${id}` }), ` ${reached} of ${total}`];

/** @param {Task} task @param {Queue["line"][number] | undefined} position */
function row(task, position) {
  const { id, submitter, service, priority, deadline, submitted, reason = "" } = task;
  return h(
    "tr",
    { key: id },
    h("td", id),
    h("td", state(task), reason && h("span.dim", ` ${reason}`)),
    h("td", submitter),
    h("td", service.slice(robotOf(service).length)),
    h("td", progress(task)),
    h("td", priority),
    h("td.wraps", turn(task, position)),
    h("td.wraps", deadline && [atTime(deadline), ", ", remaining(deadline)]),
    h("td", atTime(submitted)),
  );
}

/** Since when it runs, or when it may. @param {Task} task @param {Queue["line"][number] | undefined} position */
function turn({ state, started, not_before: begins }, position) {
  if (state === "running") return started && ["since ", atTime(started)];
  if (begins && begins > now()) return ["not before ", atTime(begins)];
  return position && [`position ${position.position}`, position.expected && [", at the latest ", atTime(position.expected)]];
}

/** @param {Task} task */
function endedRow(task) {
  const { id, submitter, service, ended, reason = "" } = task;
  return h("tr", { key: id }, h("td", id), h("td", state(task)), h("td", submitter), h("td", service), h("td", progress(task)), h("td", ended && atTime(ended)), h("td.wide", reason));
}
