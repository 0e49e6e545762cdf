// The frame: the identity, the places, and the end of the session.

import { onEnd } from "./data/api.js";
import { idOf, load } from "./data/identity.js";
import { halt, live, onChange, start } from "./data/live.js";
import { partsOf } from "./data/route.js";
import * as sessions from "./data/session.js";
import * as robots from "./pages/robots.js";
import { h, mount, refresh } from "./view/dom.js";
import { action, page, rejected } from "./view/parts.js";

/**
 * @typedef {import("./data/identity.js").Identity} Identity
 * @typedef {import("./data/session.js").Session} Session
 * @typedef {import("./view/dom.js").Child} Child
 * @typedef {{ show: () => Child, end?: () => void }} Page
 * @typedef {{ place: string, parts: string[], identity: Identity, session: Session }} Visit
 * @typedef {{ open: (visit: Visit) => Page }} Module
 */

const PLACES = {
  robots: "Robots",
  tasks: "Tasks",
  feed: "Feed",
  access: "Access",
  policies: "Policies",
  identities: "Identities",
  blocks: "Blocks",
  nodes: "Nodes",
};

/** The places that belong to others. @type {Record<string, string>} */
const WITHIN = { tx: "blocks", search: "blocks", can: "access" };

/**
 * The module of a place. All but that of the start page is loaded when it is visited.
 * @param {string} place
 * @param {string[]} parts
 * @returns {Module | Promise<Module>}
 */
function moduleOf(place, parts) {
  switch (place) {
    case "feed":
      return import("./pages/feed.js");
    case "blocks":
      return parts.length ? import("./pages/block.js") : import("./pages/blocks.js");
    case "search":
      return import("./pages/blocks.js");
    case "tx":
      return import("./pages/transaction.js");
    case "tasks":
      return import("./pages/tasks.js");
    case "access":
      return import("./pages/access.js");
    case "policies":
      return import("./pages/policies.js");
    case "can":
      return import("./pages/can.js");
    case "identities":
      return import("./pages/identities.js");
    case "nodes":
      return import("./pages/nodes.js");
    default:
      return parts.length ? import("./pages/robot.js") : robots;
  }
}

/** The parts of the address behind the #. */
const route = () => partsOf(location.hash);

/** A link of ledgerctl console, with its secret. @param {string[]} where */
const isLink = (where) => where[0] === "enrol" && where.length >= 4;

/** @type {"begins" | "stranger" | "open" | "ended"} */
let state = "begins";
/** @type {Identity | undefined} */
let identity;
/** @type {unknown} */
let error;
/** @type {Page | undefined} */
let shown;
/** Counts visits: a module that arrives after the next visit is not opened. */
let visits = 0;

/** @param {Page | undefined} next */
function turnTo(next) {
  shown?.end?.();
  shown = next;
  refresh();
}

/** @type {Session | undefined} */
let session;

/** Opens the page of the address. */
async function visit() {
  if (state !== "open" || !identity || !session) return;
  const [place = "robots", ...parts] = route();
  const own = ++visits;
  try {
    const { open } = await moduleOf(place, parts);
    if (own === visits && state === "open") turnTo(open({ place, parts, identity, session }));
  } catch (failed) {
    if (own === visits) turnTo({ show: () => page("This page cannot be loaded", null, rejected(failed)) });
  }
}

/** @param {Identity} as */
async function enter(as) {
  identity = as;
  error = undefined;
  try {
    session = await sessions.open(as);
    state = "open";
    start(session.role === "admin");
    await visit();
  } catch (failed) {
    error = failed;
    ended();
  }
}

function ended() {
  halt();
  state = "ended";
  turnTo(undefined);
}

/** Offers to enrol. @param {string[]} where */
async function welcome(where) {
  const enrol = await import("./pages/enrol.js");
  // An identity that is here already is not replaced unseen.
  const own = await load().catch(() => undefined);
  halt();
  state = "stranger";
  turnTo(enrol.open(isLink(where) ? where : [], error, enter, own));
}

async function begin() {
  const where = route();
  try {
    const known = await load();
    if (known && !isLink(where)) {
      if (where[0] === "enrol") location.hash = "#/robots";
      return await enter(known);
    }
  } catch (failed) {
    error = failed;
  }
  await welcome(where);
}

function moved() {
  const where = route();
  void (isLink(where) ? welcome(where) : visit());
}

/** What stays in sight stays below the header. @param {HTMLElement} header */
function measured(header) {
  new ResizeObserver(() => document.documentElement.style.setProperty("--header", `${header.offsetHeight}px`)).observe(header);
}

function header() {
  const place = route()[0] ?? "robots";
  const { status, connected } = live;
  return h(
    "header",
    { mounted: measured },
    h("a.brand", { href: "#/robots" }, "ledgerd ", h("span", status?.network_label)),
    h(
      "nav",
      { "aria-label": "Places" },
      Object.entries(PLACES).map(([name, title]) =>
        h("a", { key: name, href: `#/${name}`, "aria-current": name === (WITHIN[place] ?? place) ? "page" : undefined }, title),
      ),
    ),
    h(
      "p.me",
      h(`span.live.${connected ? "on" : "off"}`, { role: "status" }, connected ? "live" : "not connected"),
      h("span.dim", `block ${status?.height ?? ""}`),
      h("span", identity && idOf(identity)),
    ),
  );
}

/** @param {Event} event */
function skip(event) {
  event.preventDefault();
  document.querySelector("main")?.focus();
}

/** @param {Identity} as */
function ending(as) {
  const again = action("again", { kind: "main", run: () => enter(as), failed: () => undefined }, `Continue as ${idOf(as)}`);
  again.props["mounted"] = (/** @type {HTMLElement} */ button) => button.focus();
  return h(
    "section.alone",
    { "aria-label": "Session", role: "alertdialog" },
    h("h1", "The session has ended"),
    h("p", "A session ends with its page, after some minutes without a connection, and when its node stops."),
    rejected(error),
    again,
  );
}

function frame() {
  if (state === "begins") return h("main.alone", { key: "begins", "aria-busy": true });
  if (state === "stranger" || !identity) return shown?.show();
  return [
    h("a.skip", { href: "#main", onclick: skip }, "To the content"),
    header(),
    h("main", { key: "main", id: "main", tabindex: -1 }, state === "ended" ? ending(identity) : shown?.show()),
  ];
}

onEnd(ended);
onChange(refresh);
addEventListener("hashchange", moved);
addEventListener("pagehide", sessions.close);
// A page that returns from the browser's memory has no session any more.
addEventListener("pageshow", (event) => event.persisted && location.reload());
mount(/** @type {Element} */ (document.getElementById("app")), frame);
void begin();
