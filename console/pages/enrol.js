// The page of a browser without an identity: it enrols by a link of ledgerctl console.

import { enrol } from "../data/session.js";
import { h, refresh } from "../view/dom.js";
import { action, rejected } from "../view/parts.js";

/**
 * @param {string[]} link the parts of the address: enrol, organisation, name, secret
 * @param {unknown} before an error of before
 * @param {(identity: import("../data/identity.js").Identity) => Promise<void>} entered
 */
export function open([, organisation = "", name = "", secret = ""], before, entered) {
  let error = before;
  const failed = (/** @type {unknown} */ found) => void (error = found);
  // The secret leaves the address, and so the browser's history.
  history.replaceState(null, "", "#/enrol");
  const run = async () => {
    const identity = await enrol(organisation, name, secret);
    location.hash = "#/robots";
    await entered(identity);
    refresh();
  };
  const link = () => [
    h("p", "This browser becomes ", h("b", `${organisation}/${name}`), ". It makes a key of its own, which no page can read and which never leaves it."),
    h("div", action("enrol", { kind: "main", run, failed }, "Enrol this browser")),
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
