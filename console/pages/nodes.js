// The nodes of the network: each by its own report to the node of this console, and its links as that node sees them.

import { get } from "../data/api.js";
import { size, span } from "../data/bytes.js";
import { now } from "../data/ledger.js";
import { live } from "../data/live.js";
import { h } from "../view/dom.js";
import { Asked, empty, facts, onDay, page, rejected, table } from "../view/parts.js";

/**
 * @typedef {import("../answers.js").Status} Status
 * @typedef {import("../answers.js").NodeOfNetwork} NodeOfNetwork
 */

const NODES_MS = 5000;

export function open() {
  /** @type {Asked<{ nodes: NodeOfNetwork[] }>} */
  const asked = new Asked(() => get("/v1/nodes"), NODES_MS);
  return {
    end: () => asked.end(),
    show() {
      const own = live.status;
      if (!own) return page("Nodes", null, empty("Asking the node…"));
      const nodes = asked.answer?.nodes ?? [];
      // Of one answer: a later report of the node of this page would make each of them seem behind.
      const newest = Math.max(0, ...nodes.map(({ status }) => status?.height ?? 0));
      return page(
        "Nodes",
        h("span.dim", `as ${own.organisation}/${own.node_name} sees them`),
        alarms(own),
        table(
          "Nodes",
          ["Node", "Role", "Address", "Connected", "Height", "Lag", "Disk free", "Certificate", "Version"],
          nodes.map((node) => row(node, own, newest)),
        ),
        rejected(asked.error),
        !asked.answer && asked.error === undefined && empty("Asking the nodes…"),
        asked.answer && nodes.length === 0 && empty("This node lists no node of the network."),
        h("h2", "This node"),
        describe(own),
        h("h2", "Certificates"),
        certificates(own),
      );
    },
  };
}

/**
 * What needs attention, by the node's own list.
 * @param {Status} status
 */
function alarms({ attention }) {
  return attention.map(({ check, severity, message, next }) => {
    const style = severity !== "warning" ? "div.rejected" : "p.warning";
    return h(style, { key: `${check}/${message}`, role: "alert" }, h("strong", `${check}:`), ` ${message}. `, h("span.dim", next));
  });
}

/** @param {Status} own */
function describe(own) {
  const { disk } = own;
  return facts(
    ["Leader", leader(own)],
    ["Term", own.term],
    ["Height", `${own.height}, certified to ${own.certified}`],
    ["Voters", `${own.voters_reachable} of ${own.voters} connected`],
    ["Divergence", own.divergence || "none: all agree"],
    ["Disk", h("span", { class: warning(own, "disk") }, `${size(disk.free_bytes)} free of ${size(disk.total_bytes)}, accepts ${disk.accepts}`)],
    ["Memory", size(own.resident_bytes)],
    ["Running for", span(own.uptime_ms * 1000)],
    ["Calls", `${own.in_flight} of ${own.in_flight_max} in flight, ${own.subscribers} subscriptions`],
    ["Version", own.version],
  );
}

/** @param {Status} own */
function certificates(own) {
  const shown = own.certificates.filter(({ kind }) => kind !== "list").sort((one, other) => one.not_after - other.not_after);
  const rows = shown.map(({ kind, name, not_after: notAfter }) => {
    const left = notAfter - now();
    return h("tr", { key: `${kind}/${name}` }, h("td", kind), h("td.wide", name), h("td", onDay(notAfter)), h("td", { class: warning(own, "certificate", name) }, span(left)));
  });
  return table("Certificates", ["Kind", "Name", "Ends", "In"], rows);
}

/**
 * Marks what needs attention: of this check, and of this name where there are several.
 * @param {Status} status
 * @param {string} check
 */
function warning({ attention }, check, name = "") {
  return attention.some((item) => item.check === check && item.message.includes(name)) ? "soon" : undefined;
}

/**
 * A node: `own` is the node of this console, `newest` the newest block of any node.
 * @param {NodeOfNetwork} node
 * @param {Status} own
 * @param {number} newest
 */
function row({ id, name, organisation, status, reason }, own, newest) {
  const peer = own.peers.find(({ node_id: of }) => of === id);
  const isHere = id === own.node_id;
  const connected = isHere || peer?.connected === true;
  const full = `${organisation}/${name}`;
  return h(
    "tr",
    { key: id },
    h("td", isHere ? h("b", full) : full),
    h("td", id === own.leader_id ? "leader" : (status?.role ?? peer?.role)),
    h("td", isHere ? "this node" : peer?.address),
    h("td", h(`span.what.${connected ? "good" : "bad"}`, connected ? "yes" : "no")),
    status ? report(status, newest) : h("td.wide.dim", { colspan: 5 }, reason),
  );
}

/**
 * The cells of a node's own report.
 * @param {Status} status
 * @param {number} newest
 */
function report(status, newest) {
  const { height, catching_up_to: upTo, certificates, disk, version } = status;
  const behind = Math.max(0, newest - height);
  const certificate = certificates.find(({ kind }) => kind === "node");
  const left = certificate && certificate.not_after - now();
  return [
    h("td", height),
    h("td", upTo ? `${behind} blocks, fetching` : behind),
    h("td", { class: warning(status, "disk") }, size(disk.free_bytes)),
    h("td", { class: warning(status, "certificate", certificate?.name) }, left !== undefined && `${span(left)} left`),
    h("td", version),
  ];
}

/** @param {Status} own */
function leader({ leader_id: leads, node_id: here, organisation, node_name: name, peers }) {
  if (leads === 0) return "none is known";
  if (leads === here) return `${organisation}/${name}, this node`;
  const found = peers.find(({ node_id: of }) => of === leads);
  return found ? `${found.organisation}/${found.name}` : `node ${leads}`;
}
