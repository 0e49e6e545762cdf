// The page of a browser without an identity: it enrols by a link of ledgerctl console.

import { idOf } from "../data/identity.js";
import { enrol } from "../data/session.js";
import { h, refresh } from "../view/dom.js";
import { action, rejected } from "../view/parts.js";

/** @typedef {import("../data/identity.js").Identity} Identity */

/**
 * @param {string[]} link the parts of the address: enrol, organisation, name, secret
 * @param {unknown} before an error of before
 * @param {(identity: Identity) => Promise<void>} entered
 * @param {Identity | undefined} own the identity that this browser has already
 */
export function open([, organisation = "", name = "", secret = ""], before, entered, own) {
  let error = before;
  const failed = (/** @type {unknown} */ found) => void (error = found);
  // The secret leaves the address, and so the browser's history.
  history.replaceState(null, "", "#/enrol");
  const enter = async (/** @type {Identity} */ identity) => {
    location.hash = "#/robots";
    await entered(identity);
    refresh();
  };
  const run = async () => enter(await enrol(organisation, name, secret));
  const label = own ? `Replace ${idOf(own)}` : "Enrol this browser";
  const link = () => [
    h("p", "This browser becomes ", h("b", `${organisation}/${name}`), ". It makes a key of its own, which no page can read and which never leaves it."),
    own && h("p", { role: "alert" }, "This browser is ", h("b", idOf(own)), " now. Its key is deleted, and nobody can restore it."),
    h(
      "div.actions",
      action("enrol", { kind: own ? "danger" : "main", run, failed }, label),
      own && action("stay", { kind: "main", run: () => enter(own), failed }, `Stay ${idOf(own)}`),
    ),
  ];
  const none = () => [
    h("p", "This browser has no identity here yet. An admin of your organisation prints a link for it:"),
    h("pre", { tabindex: 0 }, "ledgerctl console NAME"),
  ];
  return {
    show: () =>
      h(
        "main.alone",
        h("h1", "ledgerd"),
        !isSecureContext && h("div.rejected", { role: "alert" }, "This address is not secure, so the browser makes no keys. Open the console by HTTPS, or at localhost."),
        secret ? link() : none(),
        rejected(error),
      ),
  };
}
