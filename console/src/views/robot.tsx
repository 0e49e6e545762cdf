// One robot: who holds it, who waits, how its messages flow, and what may be done about it.

import type { JSX } from "preact";
import { useEffect, useMemo, useState } from "preact/hooks";
import type uPlot from "uplot";
import { clock, moment } from "../bytes";
import type { Line, Robot, Service } from "../contract";
import type { Identity } from "../identity";
import { invoke, query } from "../ledger";
import { feed, readRobots, robots } from "../live";
import { Messages, quantile } from "../messages";
import { useAnswer, useStore, useTick } from "../store";
import { Chart } from "./chart";
import { Action, Empty, Fact, Facts, Page, Refused, Remaining, Table, address } from "./parts";
import { Mark, stateOf } from "./robots";
import { Entries } from "./feed";

const TWIST = "geometry_msgs/msg/Twist";

export function OneRobot({ name, identity, id }: { name: string; identity: Identity; id: string }): JSX.Element {
  useTick();
  const all = useStore(robots);
  const robot = all?.find((each) => each.Name === name);
  const [error, setError] = useState<unknown>();
  const [reason, setReason] = useState("");
  const entries = useStore(feed);
  if (!robot) return <Page title={name}>{all && <Empty>There is no robot {name}.</Empty>}</Page>;
  const act = (what: string, ...args: string[]) => async () => {
    await invoke(identity, "abac", what, ...args);
    setReason("");
    await readRobots();
  };
  const about = entries.filter((entry) => entry.subject === name || entry.subject.startsWith(`${name}/`));
  return (
    <Page title={name} aside={<Mark state={stateOf(robot)} />}>
      <Facts>
        <Fact name="Owner">{robot.organisation}</Fact>
        <Fact name="Requires">{robot.attribute_required}</Fact>
        {robot.stopped && (
          <Fact name="Stopped">
            by {robot.stopped.by} at {clock(robot.stopped.since)}
            {robot.stopped.reason && `: ${robot.stopped.reason}`}
          </Fact>
        )}
      </Facts>
      <div class="actions">
        {robot.stopped ? (
          <Action kind="main" run={act("resume", name)} refused={setError}>
            Resume
          </Action>
        ) : (
          <Action kind="danger" run={act("stop", name, ...(reason ? [reason] : []))} refused={setError}>
            Stop
          </Action>
        )}
        <label>
          <span>Reason</span>
          <input value={reason} maxLength={200} placeholder="why, for the others" onInput={(event) => setReason(event.currentTarget.value)} />
        </label>
      </div>
      {error !== undefined && <Refused error={error} />}
      {robot.services.map((service) => (
        <OneService key={service.service} service={service} robot={robot} id={id} reason={reason} act={act} refused={setError} />
      ))}
      <h2>Lately</h2>
      <Entries entries={about.slice(0, 20)} />
    </Page>
  );
}

interface Shown {
  service: Service;
  robot: Robot;
  id: string;
  reason: string;
  act: (what: string, ...args: string[]) => () => Promise<void>;
  refused: (error: unknown) => void;
}

function OneService({ service, robot, id, reason, act, refused }: Shown): JSX.Element {
  const { answer: line } = useAnswer(() => query<Line>("abac", "line", service.service), [service.service, service.epoch, service.waiting], 5000);
  const isCommand = service.direction === "command";
  const holds = service.holders.includes(id);
  const waits = line?.line.some((place) => place.contender === id) ?? false;
  const held = service.holders.length > 0;
  return (
    <section aria-label={service.service}>
      <div class="head">
        <h2>{service.topic}</h2>
        <span class="dim">
          {service.type} · {service.mode} · {service.direction}
        </span>
      </div>
      {isCommand && (
        <>
          <p>
            {held ? (
              <>
                Held by <b>{service.holders.join(", ")}</b>, epoch {service.epoch}, <Remaining until={service.expires} />
              </>
            ) : (
              <>Nobody holds it.</>
            )}
          </p>
          <div class="actions">
            {!holds && !waits && (
              <Action kind="main" run={act("acquire", service.service)} refused={refused} disabled={!!robot.stopped}>
                Acquire
              </Action>
            )}
            {holds && (
              <Action run={act("renew", service.service)} refused={refused}>
                Renew
              </Action>
            )}
            {(holds || waits) && (
              <Action run={act("release", service.service)} refused={refused}>
                {holds ? "Release" : "Leave the line"}
              </Action>
            )}
            {!holds && (
              <Action kind="danger" run={act("take", service.service, reason || "taken in the console")} refused={refused} disabled={!!robot.stopped}>
                Take
              </Action>
            )}
          </div>
          {line && line.line.length > 0 && (
            <Table label={`Line of ${service.service}`} head={["Position", "Contender", "Priority", "Since", "Expected"]}>
              {line.line.map((place) => (
                <tr key={place.contender}>
                  <td>{place.position}</td>
                  <td>{place.contender}</td>
                  <td>{place.priority}</td>
                  <td>{clock(place.since)}</td>
                  <td>{place.expected ? clock(place.expected) : ""}</td>
                </tr>
              ))}
            </Table>
          )}
        </>
      )}
      {service.side_door && (
        <p class="warning">Since {moment(service.side_door.since)}, others publish on {service.side_door.topic} around the ledger.</p>
      )}
      <Flow service={service} />
    </section>
  );
}

// Rate and latency of the last minute, and the last messages.
function Flow({ service }: { service: Service }): JSX.Element {
  const [count, setCount] = useState(0);
  const [error, setError] = useState<unknown>();
  const messages = useMemo(() => ({ current: undefined as Messages | undefined }), [service.service]);
  useEffect(() => {
    const made = new Messages(
      service.service,
      service.type === TWIST,
      () => {
        setError(undefined);
        setCount((before) => before + 1);
      },
      setError,
    );
    messages.current = made;
    return () => made.end();
  }, [service.service]);
  const seconds = messages.current?.seconds ?? [];
  const last = messages.current?.last ?? [];
  const [rate, latency] = useMemo((): [uPlot.AlignedData, uPlot.AlignedData] => {
    const at = seconds.map((second) => second.at);
    const sorted = seconds.map((second) => [...second.latencies].sort((one, other) => one - other));
    const of = (part: number) => sorted.map((values) => quantile(values, part) ?? null);
    return [[at, seconds.map((second) => second.count)], [at, of(0.5), of(0.99)]];
  }, [count]);
  if (error !== undefined) return <Refused error={error} />;
  const recent = seconds.slice(-6, -1);
  const perSecond = recent.length ? recent.reduce((sum, second) => sum + second.count, 0) / recent.length : 0;
  const all = seconds.flatMap((second) => second.latencies).sort((one, other) => one - other);
  const shown = (value: number | undefined) => (value === undefined ? "none" : `${value.toFixed(1)} ms`);
  const p50 = shown(quantile(all, 0.5));
  const p99 = shown(quantile(all, 0.99));
  return (
    <>
      <div class="charts">
        <figure>
          <figcaption>
            Rate <b>{perSecond.toFixed(1)} a second</b>
          </figcaption>
          <Chart label={`Messages a second: ${perSecond.toFixed(1)}`} unit="/s" series={[{ label: "rate", color: "--accent" }]} data={rate} />
        </figure>
        <figure>
          <figcaption>
            Latency <b>p50 {p50}</b> <b>p99 {p99}</b> <span class="dim">from the signature to this page</span>
          </figcaption>
          <Chart
            label={`Latency in the last minute: p50 ${p50}, p99 ${p99}`}
            unit="ms"
            series={[
              { label: "p50", color: "--accent" },
              { label: "p99", color: "--warn", dash: [4, 3] },
            ]}
            data={latency}
          />
        </figure>
      </div>
      {last.length > 0 && (
        <Table label={`Last messages of ${service.service}`} head={["Time", "Sequence", "Latency", "Message"]}>
          {last.map((message) => (
            <tr key={`${message.at}/${message.seq}`}>
              <td>{clock(message.at)}</td>
              <td>{message.seq}</td>
              <td>{message.latencyMs.toFixed(1)} ms</td>
              <td>
                <code>{message.words}</code>
              </td>
            </tr>
          ))}
        </Table>
      )}
      <p class="dim">
        <a href={address("can", service.service)}>Who may use it, and why?</a>
      </p>
    </>
  );
}
