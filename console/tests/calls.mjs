// Calls in words: node tests/calls.mjs
import assert from "node:assert/strict";
import { happened, wordsOf } from "../data/calls.js";

const text = (response) => ({ encoding: "text", response });
const call = (name, args, more = {}) => ({ chaincode: "abac", function: name, args, events: [], creator: "Org1/Salma", code: "OK", ...more });

const words = (name, args, more) => {
  const { who, action, about } = wordsOf(call(name, args, more));
  return [who, action, ...about.map(({ text, robot }) => `${text} [${robot}]`)].join(" ");
};
assert.equal(words("acquire", [text("Rover/cmd_vel"), text("600000")]), "Org1/Salma acquire Rover/cmd_vel [Rover]");
// A robot with one service is named alone.
const message = { chaincode: "abac", name: "message", subject: "Rover/cmd_vel" };
assert.equal(words("set", [text("Rover")], { events: [message] }), "Org1/Salma publish Rover/cmd_vel [Rover]");
assert.equal(words("take", [text("Rover/cmd_vel"), text("why")]), "Org1/Salma override Rover/cmd_vel [Rover]");
assert.equal(words("stop", [text("*")]), "Org1/Salma stop all robots []");
assert.equal(words("setup", [{ encoding: "json", response: { name: "Rover" } }, { encoding: "json", response: { name: "Husky" } }]), "Org1/Salma robot add Rover [Rover] Husky [Husky]");
assert.equal(words("policy", [text("apply"), { encoding: "json", response: {} }]), "Org1/Salma policy apply []");
assert.equal(words("progress", [{ encoding: "json", response: 7 }, text("3")]), "Org1/Salma task progress task 7 []");
const registered = { chaincode: "msp", name: "registered", subject: "Org1/Farhad" };
assert.equal(words("register", [{ encoding: "json", response: { name: "Farhad" } }], { chaincode: "msp", events: [registered] }), "Org1/Salma msp register Org1/Farhad []");
assert.equal(words("acquire", [], { chaincode: "" }), "Org1/Salma not readable for you");

const block = {
  transactions: [call("set", [text("Rover/cmd_vel")]), call("set", [text("Rover/cmd_vel")]), call("acquire", [text("Husky")], { code: "LGR-3001" })],
  events: [{ chaincode: "abac", name: "released", subject: "Rover/cmd_vel", payload: { encoding: "json", response: { holder: "Org1/Salma", reason: "expired" } } }],
};
assert.deepEqual(
  happened(block).map(({ who, action, about, count }) => `${count} ${who} ${action} ${about.map((each) => each.text)}`),
  ["2 Org1/Salma publish Rover/cmd_vel", "1 Org1/Salma acquire: rejected, LGR-3001 Husky", "1 Org1/Salma released: expired Rover/cmd_vel"],
);
