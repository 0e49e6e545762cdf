// The identities of the own organisation, and when their certificates end.

import type { JSX } from "preact";
import { useState } from "preact/hooks";
import { moment, span } from "../bytes";
import type { Registered } from "../contract";
import { type Identity, endOf, idOf } from "../identity";
import { list, now } from "../ledger";
import { abandon } from "../session";
import { useAnswer } from "../store";
import { Action, Fact, Facts, Page, Refused, Table } from "./parts";

const SOON = 30 * 86400e6;

interface Shown {
  identity: Identity;
  role: string;
  attributes: Record<string, string>;
}

export function Identities({ identity, role, attributes }: Shown): JSX.Element {
  const { answer: all, error } = useAnswer(() => list<Registered>("msp", "identities"), [], 10000);
  const [refused, setRefused] = useState<unknown>();
  const forget = async () => {
    if (!confirm("Forget the key of this browser? It needs a new link then.")) return;
    await abandon();
    location.hash = "#/";
    location.reload();
  };
  return (
    <Page title="Identities">
      <section aria-label="This browser">
        <h2>This browser</h2>
        <Facts>
          <Fact name="Identity">{idOf(identity)}</Fact>
          <Fact name="Role">{role}</Fact>
          <Fact name="Attributes">{Object.entries(attributes).map(([key, value]) => `${key}=${value}`).join(", ") || "none"}</Fact>
          <Fact name="Certificate ends">{ends(endOf(identity))}</Fact>
          <Fact name="Key">P-256, kept by this browser, and cannot be read by any page</Fact>
        </Facts>
        <p class="dim">Before its certificate ends, an admin gives it a new link: ledgerctl console {identity.name} --reissue</p>
        <div class="actions">
          <Action kind="danger" run={forget} refused={setRefused}>
            Forget this identity
          </Action>
        </div>
        {refused !== undefined && <Refused error={refused} />}
      </section>
      <h2>{identity.organisation}</h2>
      {error !== undefined && <Refused error={error} />}
      {all && (
        <Table label={`Identities of ${identity.organisation}`} head={["Name", "Role", "State", "Certificate ends", "Attributes", "Registered by"]}>
          {all.map((person) => (
            <tr key={person.name}>
              <td>{person.name}</td>
              <td>{person.role}</td>
              <td>{stateOf(person)}</td>
              <td>{ends(newestEnd(person))}</td>
              <td class="wide">{Object.entries(person.attributes).map(([key, value]) => (value === "true" ? key : `${key}=${value}`)).join(", ")}</td>
              <td>{person.by}</td>
            </tr>
          ))}
        </Table>
      )}
    </Page>
  );
}

const valid = (person: Registered) => person.certificates.filter((each) => !each.revoked && each.not_after > now());
const newestEnd = (person: Registered): number => Math.max(0, ...valid(person).map((each) => each.not_after));

function stateOf(person: Registered): JSX.Element {
  if (valid(person).length > 0) return <span class="what good">enrolled</span>;
  if (person.certificates.some((each) => each.revoked)) return <span class="what bad">revoked</span>;
  if (person.certificates.length > 0) return <span class="what warn">ended</span>;
  return <span class="what">{person.secret && person.secret.expires > now() ? "may enrol" : "never enrolled"}</span>;
}

function ends(at: number): JSX.Element {
  if (!at) return <></>;
  const left = at - now();
  return (
    <span class={left < SOON ? "soon" : ""}>
      {moment(at).slice(0, 10)} <span class="dim">in {span(left)}</span>
    </span>
  );
}
