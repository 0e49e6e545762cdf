// Policies: those in force, their history, how two sets differ, and who may do what.

import type { JSX } from "preact";
import { useState } from "preact/hooks";
import { moment } from "../bytes";
import type { Can, Policy, PolicySet } from "../contract";
import { type Line, diff } from "../diff";
import { list, query } from "../ledger";
import { robots } from "../live";
import { gateway } from "../session";
import { text } from "../bytes";
import { accepted } from "../refusal";
import { useAnswer, useStore } from "../store";
import { Action, Empty, Fact, Facts, Page, Refused, Table, address } from "./parts";

export function Policies({ organisation: own, chosen }: { organisation: string; chosen: string }): JSX.Element {
  const { answer: all, error } = useAnswer(() => list<Policy>("abac", "policies"), [], 5000);
  const owners = useStore(robots)?.map((robot) => robot.organisation) ?? [];
  const organisations = [...new Set([own, ...owners, ...(all ?? []).map((policy) => policy.organisation)])].filter(Boolean).sort();
  const organisation = chosen || own;
  const theirs = all?.filter((policy) => policy.organisation === organisation);
  // The default of the network has no owner.
  const shown = theirs?.length ? theirs : all?.filter((policy) => !policy.organisation);
  return (
    <Page title="Policies" aside={<a href={address("can", "")}>Can somebody do something?</a>}>
      <div class="tabs" role="group" aria-label="Organisations">
        {organisations.map((name) => (
          <button key={name} type="button" aria-pressed={name === organisation} onClick={() => (location.hash = address("policies", name))}>
            {name}
          </button>
        ))}
      </div>
      {error !== undefined && <Refused error={error} />}
      <h2>In force</h2>
      {theirs?.length === 0 && <p class="dim">{organisation} has no policies of its own. The default decides.</p>}
      {shown?.map((policy) => (
        <details key={policy.id} open={shown.length < 4}>
          <summary>{policy.id}</summary>
          <pre tabIndex={0}>{policy.text}</pre>
        </details>
      ))}
      <History key={organisation} organisation={organisation} />
    </Page>
  );
}

function History({ organisation }: { organisation: string }): JSX.Element {
  const { answer: sets, error } = useAnswer(() => query<PolicySet[]>("abac", "policy_history", organisation), [organisation], 5000);
  const [lines, setLines] = useState<{ title: string; policies: { id: string; lines: Line[] }[] }>();
  const [refused, setRefused] = useState<unknown>();
  const compare = (version: number) => async () => {
    const [before, after] = await Promise.all([version > 1 ? texts(organisation, version - 1) : new Map<string, string>(), texts(organisation, version)]);
    const ids = [...new Set([...before.keys(), ...after.keys()])].sort();
    const policies = ids.map((id) => ({ id, lines: diff(before.get(id) ?? "", after.get(id) ?? "") }));
    setLines({ title: `Set ${version} against the one before`, policies: policies.filter(({ lines: each }) => each.some((line) => line.kind !== "same")) });
  };
  return (
    <>
      <h2>History</h2>
      {error !== undefined && <Refused error={error} />}
      {sets?.length === 0 && <Empty>No set has a number yet.</Empty>}
      {sets && sets.length > 0 && (
        <Table label={`Sets of policies of ${organisation}`} head={["Set", "Time", "By", "Message", "Block", ""]}>
          {sets.map((set) => (
            <tr key={set.version}>
              <td>{set.version}</td>
              <td>{moment(set.time)}</td>
              <td>{set.by}</td>
              <td class="wide">
                {set.message} {set.restores !== undefined && `restores ${set.restores}`} {set.break_glass && <span class="what bad">break glass</span>}
              </td>
              <td>
                <a href={address("blocks", String(set.height))}>{set.height}</a>
              </td>
              <td>
                <Action run={compare(set.version)} refused={setRefused}>
                  Changes<span class="unseen"> of set {set.version}</span>
                </Action>
              </td>
            </tr>
          ))}
        </Table>
      )}
      {refused !== undefined && <Refused error={refused} />}
      {lines && (
        <section aria-label={lines.title} role="status">
          <h2>{lines.title}</h2>
          {lines.policies.length === 0 && <Empty>No text differs.</Empty>}
          {lines.policies.map(({ id, lines: each }) => (
            <figure key={id}>
              <figcaption>{id}</figcaption>
              <pre class="diff" tabIndex={0}>
                {each.map((line, at) => (
                  <span key={at} class={line.kind}>
                    {{ same: "  ", gone: "- ", new: "+ " }[line.kind]}
                    {line.text}
                    {"\n"}
                  </span>
                ))}
              </pre>
            </figure>
          ))}
        </section>
      )}
    </>
  );
}

async function texts(organisation: string, version: number): Promise<Map<string, string>> {
  const set = await query<PolicySet>("abac", "policy_set", organisation, String(version));
  return new Map((set.policies ?? []).map((policy) => [policy.id, policy.text ?? ""]));
}

const ACTIONS = ["acquire", "publish", "subscribe", "override", "confirm", "stop", "resume"];

// Can somebody do something, and why?
export function CanForm({ service: asked, id }: { service: string; id: string }): JSX.Element {
  const all = useStore(robots);
  const [who, setWho] = useState(id);
  const [action, setAction] = useState("acquire");
  const [service, setService] = useState(asked);
  const [answer, setAnswer] = useState<Can>();
  const [error, setError] = useState<unknown>();
  const ask = async () => {
    setAnswer(undefined);
    const question = JSON.stringify({ ...(who && who !== id ? { who } : {}), action, service });
    const told = await gateway.query({ chaincode: "abac", function: "can", args: [new TextEncoder().encode(question)] });
    accepted(told.verdict);
    setAnswer(JSON.parse(text(told.response)) as Can);
  };
  const names = all?.flatMap((robot) => [robot.Name, ...robot.services.map((each) => each.service)]) ?? [];
  return (
    <Page title="Can somebody do something?">
      <form
        class="ask"
        onSubmit={(event) => {
          event.preventDefault();
          setError(undefined);
          ask().catch(setError);
        }}
      >
        <label>
          Can
          <input value={who} placeholder="ORGANISATION/NAME" onInput={(event) => setWho(event.currentTarget.value)} />
        </label>
        <label>
          do
          <select value={action} onChange={(event) => setAction(event.currentTarget.value)}>
            {ACTIONS.map((name) => (
              <option key={name}>{name}</option>
            ))}
          </select>
        </label>
        <label>
          on
          <input value={service} list="services" required placeholder="Robot/topic, or a robot" onInput={(event) => setService(event.currentTarget.value)} />
        </label>
        <datalist id="services">
          {names.map((name) => (
            <option key={name} value={name} />
          ))}
        </datalist>
        <button type="submit" class="main">
          Ask
        </button>
      </form>
      {error !== undefined && <Refused error={error} />}
      {answer && <Answer answer={answer} />}
    </Page>
  );
}

function Answer({ answer }: { answer: Can }): JSX.Element {
  const { who, action, service, allowed, code, reason, found, wanted, next, policies, conditions } = answer;
  return (
    <section aria-label="Answer" role="status">
      <p class={`verdict ${allowed ? "yes" : "no"}`}>
        <b>{allowed ? "Yes." : "No."}</b> {who} {allowed ? "may" : "may not"} {action} {service}.
      </p>
      <Facts>
        {!allowed && (
          <Fact name="Why">
            {reason} <code>{code}</code>
          </Fact>
        )}
        {found && <Fact name="Found">{found}</Fact>}
        {wanted && <Fact name="Wanted">{wanted}</Fact>}
        {next && <Fact name="Try">{next}</Fact>}
        <Fact name="Decided by">{policies.length ? policies.join(", ") : allowed ? "the owner's rights" : "no policy permits it"}</Fact>
        {answer.policy_version > 0 && <Fact name="Set of policies">{answer.policy_version}</Fact>}
      </Facts>
      {conditions.length > 0 && (
        <Table label="Conditions" head={["Policy", "Condition", "Found", "Wanted"]}>
          {conditions.map((each, at) => (
            <tr key={at}>
              <td>{each.policy}</td>
              <td>
                <code>{each.condition}</code>
              </td>
              <td>{each.found}</td>
              <td>{each.wanted}</td>
            </tr>
          ))}
        </Table>
      )}
    </section>
  );
}
