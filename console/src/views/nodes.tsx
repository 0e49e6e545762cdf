// The nodes of the network, as the node of this console sees them.

import type { JSX } from "preact";
import { moment, size, span } from "../bytes";
import { status } from "../live";
import { now } from "../ledger";
import { useStore } from "../store";
import { Empty, Fact, Facts, Page, Table } from "./parts";

const SOON = 30 * 86400e6;
const LOW_PART = 10n;

export function Nodes(): JSX.Element {
  const told = useStore(status);
  if (!told) return <Page title="Nodes">{<Empty>Asking the node…</Empty>}</Page>;
  const own = told.certificates.filter((each) => each.kind !== "list").sort((one, other) => Number(one.notAfter - other.notAfter));
  const majority = Math.floor(told.voters / 2) + 1;
  const isLeader = (id: bigint) => id === told.leaderId;
  const isLow = told.diskFreeBytes * LOW_PART < told.diskTotalBytes;
  return (
    <Page title="Nodes" aside={<span class="dim">as {told.organisation}/{told.nodeName} sees them</span>}>
      {told.divergence && (
        <div class="refused" role="alert">
          <strong>The chains differ:</strong> {told.divergence}
        </div>
      )}
      {told.lies && (
        <div class="refused" role="alert">
          <strong>A node has lied:</strong> {told.lies}
        </div>
      )}
      {told.votersConnected < majority && (
        <div class="refused" role="alert">
          <strong>No quorum:</strong> {told.votersConnected} of {told.voters} voters are connected, {majority} are needed.
        </div>
      )}
      {told.votersConnected === majority && told.voters > 2 && <p class="warning">One voter less, and nothing is ordered.</p>}
      <Table label="Nodes" head={["Node", "Role", "Address", "Connected", "Height on disk", "Lag"]}>
        <tr>
          <td>
            <b>
              {told.organisation}/{told.nodeName}
            </b>
          </td>
          <td>{told.role}</td>
          <td>this node</td>
          <td>
            <span class="what good">yes</span>
          </td>
          <td>{String(told.height)}</td>
          <td>{told.catchingUpTo ? `${told.catchingUpTo - told.height} blocks, fetching` : `${told.committed - told.height}`}</td>
        </tr>
        {told.peers.map((peer) => (
          <tr key={String(peer.nodeId)}>
            <td>
              {peer.organisation}/{peer.name}
            </td>
            <td>{isLeader(peer.nodeId) ? "leader" : peer.role}</td>
            <td>{peer.address}</td>
            <td>
              <span class={`what ${peer.connected ? "good" : "bad"}`}>{peer.connected ? "yes" : "no"}</span>
            </td>
            <td>{peer.matched ? String(peer.matched) : ""}</td>
            <td>{peer.matched ? String(told.lastIndex - peer.matched) : <span class="dim">the leader knows</span>}</td>
          </tr>
        ))}
      </Table>
      <h2>This node</h2>
      <Facts>
        <Fact name="Leader">{leader(told)}</Fact>
        <Fact name="Term">{String(told.term)}</Fact>
        <Fact name="Height">
          {String(told.height)}, certified to {String(told.certified)}
        </Fact>
        <Fact name="Voters">
          {told.votersConnected} of {told.voters} connected
        </Fact>
        <Fact name="Divergence">{told.divergence || "none: all agree"}</Fact>
        <Fact name="Disk">
          <span class={isLow || told.diskAccepts !== "all" ? "soon" : ""}>
            {size(told.diskFreeBytes)} free of {size(told.diskTotalBytes)}, accepts {told.diskAccepts}
          </span>
        </Fact>
        <Fact name="Memory">{size(told.residentBytes)}</Fact>
        <Fact name="Running for">{span(told.uptimeMs * 1000n)}</Fact>
        <Fact name="Calls">
          {String(told.inFlight)} of {String(told.inFlightMax)} in flight, {String(told.subscribers)} subscriptions
        </Fact>
        <Fact name="Version">{told.version}</Fact>
      </Facts>
      <h2>Certificates</h2>
      <Table label="Certificates" head={["Kind", "Name", "Ends", "In"]}>
        {own.map((each) => {
          const left = Number(each.notAfter) - now();
          return (
            <tr key={`${each.kind}/${each.name}`}>
              <td>{each.kind}</td>
              <td class="wide">{each.name}</td>
              <td>{moment(each.notAfter).slice(0, 10)}</td>
              <td class={left < SOON ? "soon" : ""}>{span(left)}</td>
            </tr>
          );
        })}
      </Table>
    </Page>
  );
}

function leader({ leaderId, nodeId, organisation, nodeName, peers }: { leaderId: bigint; nodeId: bigint; organisation: string; nodeName: string; peers: { nodeId: bigint; organisation: string; name: string }[] }): string {
  if (leaderId === 0n) return "none is known";
  if (leaderId === nodeId) return `${organisation}/${nodeName}, this node`;
  const found = peers.find((peer) => peer.nodeId === leaderId);
  return found ? `${found.organisation}/${found.name}` : `node ${leaderId}`;
}
