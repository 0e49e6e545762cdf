// What happened: grants, refusals, revocations, stops.

import type { JSX } from "preact";
import { useState } from "preact/hooks";
import { clock, hex } from "../bytes";
import { type Entry, delay, feed } from "../live";
import { useStore } from "../store";
import { Empty, Page, Table, address } from "./parts";

const KINDS: Record<string, string[]> = {
  all: [],
  grants: ["granted", "released", "delegated", "queued", "left", "pending", "confirmed"],
  refusals: ["refused"],
  revocations: ["revoked"],
  stops: ["stopped", "resumed"],
};

const TONES: Record<string, string> = { granted: "good", resumed: "good", refused: "warn", revoked: "bad", stopped: "bad", side_door: "warn" };

export function Feed(): JSX.Element {
  const entries = useStore(feed);
  const late = useStore(delay);
  const [kind, setKind] = useState("all");
  const wanted = KINDS[kind]!;
  return (
    <Page title="Feed" aside={<span class="dim">{late !== undefined && `newest event: ${Math.round(late)} ms after its block`}</span>}>
      <div class="tabs" role="group" aria-label="Kinds of entries">
        {Object.keys(KINDS).map((name) => (
          <button key={name} type="button" aria-pressed={name === kind} onClick={() => setKind(name)}>
            {name}
          </button>
        ))}
      </div>
      <div aria-live="polite" aria-relevant="additions">
        <Entries entries={entries.filter((entry) => wanted.length === 0 || wanted.includes(entry.name))} />
      </div>
    </Page>
  );
}

export function Entries({ entries }: { entries: Entry[] }): JSX.Element {
  if (entries.length === 0) return <Empty>Nothing yet.</Empty>;
  return (
    <Table label="Entries" head={["Time", "What", "About", "Who", "Detail", "Block"]}>
      {entries.map((entry) => (
        <tr key={entry.key}>
          <td title={String(entry.time)}>{clock(entry.time)}</td>
          <td>
            <span class={`what ${TONES[entry.name] ?? ""}`}>{entry.name}</span>
          </td>
          <td>{entry.subject}</td>
          <td>{entry.who}</td>
          <td class="wide">
            {entry.code && <code>{entry.code}</code>} {entry.detail}
          </td>
          <td>
            <a href={entry.transaction ? address("tx", hex(entry.transaction)) : address("blocks", String(entry.height))}>{entry.height}</a>
          </td>
        </tr>
      ))}
    </Table>
  );
}
