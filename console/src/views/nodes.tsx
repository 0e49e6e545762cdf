// The nodes of the network: each as it describes itself to the node of this console, and its links as that node sees them.

import type { JSX } from "preact";
import { moment, size, span } from "../bytes";
import type { NodeStatus, StatusResponse } from "../gen/ledgerd/v1/gateway_pb";
import { status } from "../live";
import { now } from "../ledger";
import { gateway } from "../session";
import { useAnswer, useStore } from "../store";
import { Empty, Fact, Facts, Page, Table } from "./parts";

const NODES_MS = 5000;
const SOON = 30 * 86400e6;
const LOW_PART = 10n;

export function Nodes(): JSX.Element {
  const told = useStore(status);
  const { answer } = useAnswer(() => gateway.nodes({}), [], NODES_MS);
  if (!told) return <Page title="Nodes">{<Empty>Asking the node…</Empty>}</Page>;
  const own = told.certificates.filter((each) => each.kind !== "list").sort((one, other) => Number(one.notAfter - other.notAfter));
  const majority = Math.floor(told.voters / 2) + 1;
  const newest = (answer?.nodes ?? []).reduce((height, { status }) => (status && status.committed > height ? status.committed : height), told.committed);
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
      <Table label="Nodes" head={["Node", "Role", "Address", "Connected", "Height", "Lag", "Disk free", "Certificate", "Version"]}>
        {(answer?.nodes ?? []).map((node) => (
          <Row key={String(node.nodeId)} node={node} told={told} newest={newest} />
        ))}
      </Table>
      {!answer && <Empty>Asking the nodes…</Empty>}
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
          <span class={isShort(told) ? "soon" : ""}>
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

const isShort = ({ diskFreeBytes, diskTotalBytes, diskAccepts }: StatusResponse): boolean => diskFreeBytes * LOW_PART < diskTotalBytes || diskAccepts !== "all";

// A node: `told` is the node of this console, `newest` the newest block that any node knows.
function Row({ node, told, newest }: { node: NodeStatus; told: StatusResponse; newest: bigint }): JSX.Element {
  const peer = told.peers.find(({ nodeId }) => nodeId === node.nodeId);
  const isHere = node.nodeId === told.nodeId;
  const connected = isHere || peer?.connected === true;
  const name = `${node.organisation}/${node.name}`;
  return (
    <tr>
      <td>{isHere ? <b>{name}</b> : name}</td>
      <td>{node.nodeId === told.leaderId ? "leader" : (node.status?.role ?? peer?.role)}</td>
      <td>{isHere ? "this node" : peer?.address}</td>
      <td>
        <span class={`what ${connected ? "good" : "bad"}`}>{connected ? "yes" : "no"}</span>
      </td>
      {node.status ? <Words status={node.status} newest={newest} /> : <td colSpan={5} class="wide dim">{node.unreachable}</td>}
    </tr>
  );
}

// What a node says of itself.
function Words({ status, newest }: { status: StatusResponse; newest: bigint }): JSX.Element {
  const { height, catchingUpTo, certificates, diskFreeBytes, version } = status;
  const behind = newest > height ? newest - height : 0n;
  const certificate = certificates.find(({ kind }) => kind === "node");
  const left = certificate && Number(certificate.notAfter) - now();
  return (
    <>
      <td>{String(height)}</td>
      <td>{catchingUpTo ? `${behind} blocks, fetching` : String(behind)}</td>
      <td class={isShort(status) ? "soon" : ""}>{size(diskFreeBytes)}</td>
      <td class={left !== undefined && left < SOON ? "soon" : ""}>{left !== undefined && `${span(left)} left`}</td>
      <td>{version}</td>
    </>
  );
}

function leader({ leaderId, nodeId, organisation, nodeName, peers }: { leaderId: bigint; nodeId: bigint; organisation: string; nodeName: string; peers: { nodeId: bigint; organisation: string; name: string }[] }): string {
  if (leaderId === 0n) return "none is known";
  if (leaderId === nodeId) return `${organisation}/${nodeName}, this node`;
  const found = peers.find((peer) => peer.nodeId === leaderId);
  return found ? `${found.organisation}/${found.name}` : `node ${leaderId}`;
}
