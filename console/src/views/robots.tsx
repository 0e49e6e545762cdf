// All robots, live.

import type { JSX } from "preact";
import { useState } from "preact/hooks";
import type { Robot, Service } from "../contract";
import { robots } from "../live";
import { useStore, useTick } from "../store";
import { Empty, Page, Remaining, address } from "./parts";

type State = "stopped" | "held" | "free";

const commands = (robot: Robot): Service[] => robot.services.filter((service) => service.direction === "command");

export function stateOf(robot: Robot): State {
  if (robot.stopped) return "stopped";
  return commands(robot).some((service) => service.holders.length > 0) ? "held" : "free";
}

export function Mark({ state }: { state: State }): JSX.Element {
  return <span class={`mark ${state}`}>{state}</span>;
}

export function Robots(): JSX.Element {
  useTick();
  const all = useStore(robots);
  const [search, setSearch] = useState("");
  const words = search.toLowerCase();
  const shown = all?.filter((robot) => `${robot.Name} ${robot.organisation}`.toLowerCase().includes(words));
  const count = (state: State) => all?.filter((robot) => stateOf(robot) === state).length ?? 0;
  return (
    <Page
      title="Robots"
      aside={
        <label class="search">
          <span class="unseen">Search robots</span>
          <input type="search" placeholder="Search" value={search} onInput={(event) => setSearch(event.currentTarget.value)} />
        </label>
      }
    >
      {all && (
        <p class="summary">
          {all.length} robots · <b>{count("held")}</b> held · <b>{count("stopped")}</b> stopped · <b>{count("free")}</b> free
        </p>
      )}
      {all?.length === 0 && <Empty>There is no robot. Its owner registers one: ledgerctl robot add</Empty>}
      <ul class="map">
        {shown?.map((robot) => (
          <li key={robot.Name} class={stateOf(robot)}>
            <div class="title">
              <a href={address("robots", robot.Name)}>{robot.Name}</a>
              <Mark state={stateOf(robot)} />
            </div>
            <p class="dim">{robot.organisation}</p>
            {robot.stopped && (
              <p class="note">
                by {robot.stopped.by}
                {robot.stopped.reason && `: ${robot.stopped.reason}`}
              </p>
            )}
            <ul class="services">
              {robot.services.map((service) => (
                <li key={service.service}>
                  <span class="topic">{service.topic}</span>
                  <span class="rule">{service.mode}</span>
                  <Holder service={service} />
                </li>
              ))}
            </ul>
          </li>
        ))}
      </ul>
    </Page>
  );
}

function Holder({ service }: { service: Service }): JSX.Element {
  const [first, ...others] = service.holders;
  const waiting = service.waiting ? ` · ${service.waiting} in line` : "";
  if (!first) return <span class="dim">{service.direction === "feed" ? "feed" : `nobody${waiting}`}</span>;
  return (
    <span class="holder">
      {first}
      {others.length > 0 && ` and ${others.length} more`} · <Remaining until={service.expires} />
      {waiting}
    </span>
  );
}
