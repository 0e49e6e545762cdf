// Small parts of views.

import type { ComponentChildren, JSX } from "preact";
import { useEffect, useRef, useState } from "preact/hooks";
import { span } from "../bytes";
import { now } from "../ledger";
import { refusal } from "../refusal";

export function Refused({ error }: { error: unknown }): JSX.Element {
  const { message, code, found, wanted, next } = refusal(error);
  return (
    <div class="refused" role="alert">
      <p>
        <strong>{message}</strong> {code && <code>{code}</code>}
      </p>
      {(found || wanted || next) && (
        <dl>
          {found && [<dt>found</dt>, <dd>{found}</dd>]}
          {wanted && [<dt>wanted</dt>, <dd>{wanted}</dd>]}
          {next && [<dt>try</dt>, <dd>{next}</dd>]}
        </dl>
      )}
    </div>
  );
}

// A button for something that lasts. It cannot be pressed twice, and its refusal is shown where `refused` says.
export function Action(props: {
  children: ComponentChildren;
  kind?: "danger" | "plain" | "main";
  disabled?: boolean;
  run: () => Promise<unknown>;
  refused: (error: unknown) => void;
}): JSX.Element {
  const [busy, setBusy] = useState(false);
  const pressed = async () => {
    setBusy(true);
    props.refused(undefined);
    try {
      await props.run();
    } catch (error) {
      props.refused(error);
    } finally {
      setBusy(false);
    }
  };
  return (
    <button type="button" class={props.kind ?? "plain"} disabled={busy || props.disabled} aria-busy={busy} onClick={pressed}>
      {props.children}
    </button>
  );
}

export function Remaining({ until }: { until: number }): JSX.Element {
  const left = until - now();
  return <span class={left < 3e6 ? "soon" : ""}>{left > 0 ? `${span(left)} left` : "ends now"}</span>;
}

export function Page({ title, aside, children }: { title: string; aside?: ComponentChildren; children: ComponentChildren }): JSX.Element {
  const heading = useRef<HTMLHeadingElement>(null);
  useEffect(() => {
    document.title = `${title} · ledgerd`;
    heading.current?.focus({ preventScroll: true });
  }, [title]);
  return (
    <>
      <div class="head">
        <h1 ref={heading} tabIndex={-1}>
          {title}
        </h1>
        {aside}
      </div>
      {children}
    </>
  );
}

export function Empty({ children }: { children: ComponentChildren }): JSX.Element {
  return <p class="empty">{children}</p>;
}

// A table. On a narrow screen each row stands by itself, and each cell with the name of its column.
export function Table({ label, head, children }: { label: string; head: string[]; children: ComponentChildren }): JSX.Element {
  const body = useRef<HTMLTableSectionElement>(null);
  useEffect(() => {
    for (const row of body.current?.rows ?? []) [...row.cells].forEach((cell, at) => (cell.dataset.name = cell.colSpan > 1 ? "" : (head[at] ?? "")));
  });
  return (
    <div class="scroll" role="region" aria-label={label} tabIndex={0}>
      <table>
        <caption class="unseen">{label}</caption>
        <thead>
          <tr>
            {head.map((name) => (
              <th scope="col" key={name}>
                {name}
              </th>
            ))}
          </tr>
        </thead>
        <tbody ref={body}>{children}</tbody>
      </table>
    </div>
  );
}

export function Facts({ children }: { children: ComponentChildren }): JSX.Element {
  return <dl class="facts">{children}</dl>;
}

export function Fact({ name, children }: { name: string; children: ComponentChildren }): JSX.Element {
  return (
    <div>
      <dt>{name}</dt>
      <dd>{children}</dd>
    </div>
  );
}

export const address = (...parts: string[]): string => `#/${parts.map(encodeURIComponent).join("/")}`;
