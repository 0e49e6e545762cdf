// Calls in words: who did what with which robot.

/**
 * @typedef {import("../answers.js").Transaction} Transaction
 * @typedef {import("../answers.js").Answer} Answer
 * @typedef {{ text: string, robot: string }} Subject `robot` is empty if it is none
 * @typedef {{ who: string, action: string, about: Subject[] }} Words
 */

/** Actions by the names that ledgerctl has for them, where the ledger has others. @type {Record<string, string>} */
const ACTIONS = {
  acquire_all: "acquire",
  configure: "robot set",
  fail: "task fail",
  cancel: "task cancel",
  progress: "task progress",
  policy: "policy",
  reader: "read",
  remove: "robot remove",
  replace: "robot add",
  set: "publish",
  setup: "robot add",
  share: "share keys",
  submit: "task submit",
  take: "override",
};

/** Calls about robots by their descriptions in JSON. */
const DESCRIBED = ["setup", "replace"];
/** Calls about a task by its number. */
const OF_TASK = ["fail", "cancel", "progress"];
/** Calls whose first argument is no robot. */
const ABOUT_NONE = ["policy", "set_policy_approvals"];
const ABOUT_CHARACTERS = 80;
const ALL = "all robots";

/** @param {Answer | undefined} arg */
const text = (arg) => (arg?.encoding === "text" ? arg.response : arg?.encoding === "json" && typeof arg.response !== "object" ? String(arg.response) : "");

/**
 * The robots or services that a call of abac is about.
 * @param {Transaction} transaction
 */
function objects({ function: name, args, events }) {
  if (DESCRIBED.includes(name)) return args.map((arg) => (arg.encoding === "json" ? String(arg.response?.name ?? "") : ""));
  if (OF_TASK.includes(name)) {
    const task = events.find((event) => event.name === "task");
    return [task ? `${task.subject} (task ${text(args[0])})` : `task ${text(args[0])}`];
  }
  if (ABOUT_NONE.includes(name)) return [args.length > 1 ? text(args[0]) : ""];
  if (name === "acquire_all") return args.slice(1).map(text);
  const about = text(args[0]);
  if (about === "*") return [ALL];
  // A robot with one service may be named alone; its events name the service.
  return [events.map(({ subject }) => subject).find((subject) => subject.startsWith(`${about}/`)) ?? about];
}

/** @param {string} text @returns {Subject} */
const ofRobot = (text) => ({ text, robot: /^[^/ ]+/.exec(text)?.[0] ?? "" });

/** @param {string} text @returns {Subject} */
const ofNone = (text) => ({ text, robot: "" });

/** @param {Transaction} transaction @returns {Words} */
export function wordsOf(transaction) {
  const { creator: who, chaincode, function: name, args, events } = transaction;
  if (!chaincode) return { who, action: "not readable for you", about: [] };
  if (chaincode !== "abac") {
    const about = (events.find((event) => event.chaincode === chaincode)?.subject || text(args[0])).slice(0, ABOUT_CHARACTERS);
    return { who, action: `${chaincode} ${name}`, about: about ? [ofNone(about)] : [] };
  }
  const isNone = (/** @type {string} */ about) => ABOUT_NONE.includes(name) || about === ALL || /^task /.test(about);
  const about = objects(transaction).filter(Boolean);
  return { who, action: ACTIONS[name] ?? name, about: about.map((each) => (isNone(each) ? ofNone(each) : ofRobot(each))) };
}

/**
 * What happened in a block, each kind once with its number: calls, and what the block itself ended.
 * @param {import("../answers.js").Block} block
 * @returns {(Words & { count: number })[]}
 */
export function happened({ transactions, events }) {
  /** @type {Map<string, Words & { count: number }>} */
  const found = new Map();
  const add = (/** @type {Words} */ words) => {
    const key = JSON.stringify(words);
    const known = found.get(key) ?? { ...words, count: 0 };
    known.count += 1;
    found.set(key, known);
  };
  for (const transaction of transactions) {
    const words = wordsOf(transaction);
    add(transaction.code === "OK" ? words : { ...words, action: `${words.action}: rejected, ${transaction.code}` });
  }
  for (const { chaincode, name, subject, payload } of events) {
    const facts = payload.encoding === "json" ? payload.response : undefined;
    const about = chaincode === "abac" ? ofRobot(subject) : ofNone(subject);
    add({ who: facts?.holder ?? facts?.contender ?? facts?.submitter ?? "", action: facts?.reason ? `${name}: ${facts.reason}` : name, about: subject ? [about] : [] });
  }
  return [...found.values()];
}
