// A stop is signed and sent again until it is in force.

import { Rejection, rejectionOf } from "./api.js";
import { invoke } from "./ledger.js";
import { readRobots } from "./live.js";

const AGAIN_MS = 1000;

/**
 * Stops a robot. Where nothing can be ordered, `delayed` gets the reason of each try that failed; it ends when the stop is in force,
 * or when the page is left.
 * @param {import("./identity.js").Identity} identity
 * @param {string} robot
 * @param {string} reason
 * @param {{ isOver: () => boolean, delayed: (found: unknown) => void }} page
 */
export async function stop(identity, robot, reason, { isOver, delayed }) {
  const args = reason ? [robot, reason] : [robot];
  for (;;) {
    try {
      await invoke(identity, "abac", "stop", ...args);
      break;
    } catch (found) {
      const rejection = rejectionOf(found);
      const isOpen = rejection.status === 0 || /^LGR-(4|1006|1007)/.test(rejection.code);
      if (!isOpen) throw found;
      const message = isOver() ? `The stop of ${robot} is not in force: repeat it` : `The stop of ${robot} is not in force yet`;
      const next = "stay on this page: the stop is signed and sent again until it is in force";
      delayed(new Rejection({ message, code: rejection.code, found: rejection.message, next }));
      if (isOver()) return;
      await new Promise((done) => setTimeout(done, AGAIN_MS));
    }
  }
  delayed(undefined);
  await readRobots();
}
