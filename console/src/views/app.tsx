// The frame: who is here, where to go, and what happens when the session ends.

import type { JSX } from "preact";
import { useEffect, useState } from "preact/hooks";
import { type Identity, idOf, load } from "../identity";
import { connected, halt, start, status } from "../live";
import { type Session, close, enrol, onEnd, open } from "../session";
import { useStore } from "../store";
import { Blocks, OneBlock, OneTransaction } from "./blocks";
import { Feed } from "./feed";
import { Identities } from "./identities";
import { Nodes } from "./nodes";
import { Refused } from "./parts";
import { CanForm, Policies } from "./policies";
import { OneRobot } from "./robot";
import { Robots } from "./robots";

const PLACES: [string, string][] = [
  ["robots", "Robots"],
  ["feed", "Feed"],
  ["blocks", "Blocks"],
  ["policies", "Policies"],
  ["identities", "Identities"],
  ["nodes", "Nodes"],
];

// The parts of the address behind the #.
function route(): string[] {
  return location.hash.replace(/^#\/?/, "").split("/").filter(Boolean).map(decodeURIComponent);
}

function useRoute(): string[] {
  const [now, setNow] = useState(route());
  useEffect(() => {
    const changed = () => setNow(route());
    addEventListener("hashchange", changed);
    return () => removeEventListener("hashchange", changed);
  }, []);
  return now;
}

// A link of ledgerctl console, with its secret.
const isLink = (where: string[]): boolean => where[0] === "enrol" && where.length >= 4;

type State = "begins" | "stranger" | "open" | "ended";

export function App(): JSX.Element {
  const [identity, setIdentity] = useState<Identity>();
  const [session, setSession] = useState<Session>();
  const [state, setState] = useState<State>("begins");
  const [error, setError] = useState<unknown>();
  const where = useRoute();

  const enter = async (as: Identity): Promise<void> => {
    setError(undefined);
    setIdentity(as);
    try {
      const opened = await open(as);
      setSession(opened);
      setState("open");
      start(opened.role === "admin");
    } catch (refused) {
      setError(refused);
      setState("ended");
    }
  };

  const begin = async (): Promise<void> => {
    const known = await load();
    if (known && !isLink(where)) {
      if (where[0] === "enrol") location.hash = "#/robots";
      return enter(known);
    }
    setState("stranger");
  };

  useEffect(() => {
    onEnd(() => {
      halt();
      setState("ended");
    });
    addEventListener("pagehide", close);
    // A page that comes back from the browser's memory has no session any more.
    addEventListener("pageshow", (event) => event.persisted && location.reload());
    begin().catch((refused: unknown) => {
      setError(refused);
      setState("stranger");
    });
  }, []);

  if (state === "begins") return <main class="alone" aria-busy="true" />;
  if (state === "stranger" || !identity || isLink(where)) return <Enrol key={isLink(where) ? where.join("/") : ""} where={where} error={error} entered={enter} />;
  return (
    <>
      <a class="skip" href="#main" onClick={(event) => (event.preventDefault(), document.querySelector<HTMLElement>("main")?.focus())}>
        To the content
      </a>
      <Header where={where} id={idOf(identity)} />
      <main id="main" tabIndex={-1}>
        {session && state === "open" && <Content where={where} identity={identity} session={session} />}
        {state === "ended" && <Ended id={idOf(identity)} error={error} again={() => enter(identity)} />}
      </main>
    </>
  );
}

function Header({ where, id }: { where: string[]; id: string }): JSX.Element {
  const told = useStore(status);
  const live = useStore(connected);
  const place = where[0] ?? "robots";
  return (
    <header>
      <a class="brand" href="#/robots">
        ledgerd <span>{told?.networkLabel}</span>
      </a>
      <nav aria-label="Places">
        {PLACES.map(([name, title]) => (
          <a key={name} href={`#/${name}`} aria-current={name === place || (name === "blocks" && ["tx", "search"].includes(place)) || (name === "policies" && place === "can") ? "page" : undefined}>
            {title}
          </a>
        ))}
      </nav>
      <p class="me">
        <span class={`live ${live ? "on" : "off"}`} role="status">
          {live ? "live" : "not connected"}
        </span>
        <span class="dim">block {String(told?.height ?? "")}</span>
        <span>{id}</span>
      </p>
    </header>
  );
}

interface Shown {
  where: string[];
  identity: Identity;
  session: Session;
}

function Content({ where: [place = "robots", first = "", ...rest], identity, session }: Shown): JSX.Element {
  switch (place) {
    case "robots":
      return first ? <OneRobot key={first} name={first} identity={identity} id={session.id} /> : <Robots />;
    case "feed":
      return <Feed />;
    case "blocks":
      return first ? <OneBlock key={first} height={first} /> : <Blocks search="" />;
    case "search":
      return <Blocks key={first} search={[first, ...rest].filter(Boolean).join("/")} />;
    case "tx":
      return <OneTransaction key={first} id={first} />;
    case "policies":
      return <Policies organisation={identity.organisation} chosen={first} />;
    case "can":
      return <CanForm key={first} service={first} id={session.id} />;
    case "identities":
      return <Identities identity={identity} role={session.role} attributes={session.attributes} />;
    case "nodes":
      return <Nodes />;
    default:
      return <Robots />;
  }
}

function Ended({ id, error, again }: { id: string; error: unknown; again: () => Promise<void> }): JSX.Element {
  return (
    <section class="alone" aria-label="Session" role="alertdialog">
      <h1>The session has ended</h1>
      <p>A session ends with its page, after some minutes of silence, and when its node stops.</p>
      {error !== undefined && <Refused error={error} />}
      <button type="button" class="main" autofocus onClick={again}>
        Continue as {id}
      </button>
    </section>
  );
}

function Enrol({ where, error: before, entered }: { where: string[]; error: unknown; entered: (identity: Identity) => Promise<void> }): JSX.Element {
  const [link] = useState(isLink(where) ? where : []);
  const [, organisation = "", name = "", secret = ""] = link;
  const [error, setError] = useState<unknown>(before);
  const [busy, setBusy] = useState(false);
  // The secret goes out of the address, and so out of the browser's history.
  useEffect(() => history.replaceState(null, "", "#/enrol"), []);
  const run = async () => {
    setBusy(true);
    setError(undefined);
    try {
      const identity = await enrol(organisation, name, secret);
      location.hash = "#/robots";
      await entered(identity);
    } catch (refused) {
      setError(refused);
    }
    setBusy(false);
  };
  return (
    <main class="alone">
      <h1>ledgerd</h1>
      {!isSecureContext && (
        <div class="refused" role="alert">
          This address is not secure, so the browser makes no keys. Open the console by HTTPS, or at localhost.
        </div>
      )}
      {secret ? (
        <>
          <p>
            This browser becomes <b>{`${organisation}/${name}`}</b>. It makes a key of its own, which no page can read and which never leaves it.
          </p>
          <button type="button" class="main" disabled={busy} aria-busy={busy} onClick={run}>
            Enrol this browser
          </button>
        </>
      ) : (
        <>
          <p>This browser has no identity here yet. An admin of your organisation prints a link for it:</p>
          <pre tabIndex={0}>ledgerctl console NAME</pre>
        </>
      )}
      {error !== undefined && <Refused error={error} />}
    </main>
  );
}
