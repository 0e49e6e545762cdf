// Blocks and transactions: the newest ones, a search, a page for each, and the proof.

import { fromBinary } from "@bufbuild/protobuf";
import type { JSX } from "preact";
import { useEffect, useState } from "preact/hooks";
import { type Bytes, clock, hex, moment, own, text, unhex } from "../bytes";
import type { Block, TransactionRecord } from "../gen/ledgerd/v1/gateway_pb";
import { type TransactionBody, TransactionBodySchema, TransactionSchema } from "../gen/ledgerd/v1/transaction_pb";
import { status } from "../live";
import { type Proof, examine } from "../proof";
import { codeOf } from "../refusal";
import { gateway } from "../session";
import { useAnswer, useStore } from "../store";
import { Action, Empty, Fact, Facts, Page, Refused, Table, address } from "./parts";

const BLOCKS = 20;
const ROWS = 200;

// The signed part of a transaction; none where this identity may not read it.
function bodyOf(encoded: Uint8Array): TransactionBody | undefined {
  return encoded.length ? fromBinary(TransactionBodySchema, fromBinary(TransactionSchema, encoded).body) : undefined;
}

const callOf = (record: TransactionRecord): string => {
  const body = bodyOf(record.transaction);
  return body ? `${body.chaincode} ${body.function}` : "not for you to read";
};

// An argument as text, where it is text.
function argument(bytes: Uint8Array): string {
  const shown = text(bytes);
  return /^[\x20-\x7e\u00a0-\uffff\n]*$/.test(shown) && !shown.includes("\ufffd") ? shown : `0x${hex(bytes.slice(0, 48))}${bytes.length > 48 ? "…" : ""}`;
}

export function Blocks({ search }: { search: string }): JSX.Element {
  const [asked, setAsked] = useState(search);
  const submit = (event: Event) => {
    event.preventDefault();
    const wanted = asked.trim();
    if (/^\d+$/.test(wanted)) location.hash = address("blocks", wanted);
    else if (/^[0-9a-f]{64}$/i.test(wanted)) location.hash = address("tx", wanted.toLowerCase());
    else location.hash = address("search", wanted);
  };
  return (
    <Page title="Blocks">
      <form class="search wide" role="search" onSubmit={submit}>
        <label>
          <span class="unseen">Search by robot, user, id of a transaction, or height</span>
          <input type="search" value={asked} placeholder="Robot, ORGANISATION/USER, transaction id, or height" onInput={(event) => setAsked(event.currentTarget.value)} />
        </label>
        <button type="submit" class="main">
          Search
        </button>
      </form>
      {search ? <Found words={search} /> : <Newest />}
    </Page>
  );
}

function Newest(): JSX.Element {
  const told = useStore(status);
  const height = told?.height ?? 0n;
  const [blocks, setBlocks] = useState<Block[]>([]);
  const [error, setError] = useState<unknown>();
  useEffect(() => {
    if (!height) return;
    const known = new Map(blocks.map((block) => [block.height, block]));
    const wanted = Array.from({ length: BLOCKS }, (_, back) => height - BigInt(back)).filter((at) => at > 0n);
    Promise.all(wanted.map(async (at) => known.get(at) ?? gateway.getBlock({ height: at }))).then(setBlocks, setError);
  }, [height]);
  if (error !== undefined) return <Refused error={error} />;
  return (
    <Table label="The newest blocks" head={["Height", "Time", "Calls", "Refused", "Hash"]}>
      {blocks.map((block) => (
        <tr key={String(block.height)}>
          <td>
            <a href={address("blocks", String(block.height))}>{String(block.height)}</a>
          </td>
          <td>{clock(block.time)}</td>
          <td class="wide">{summary(block)}</td>
          <td>{block.transactions.filter((record) => record.verdict?.code).length || ""}</td>
          <td>
            <code>{hex(block.hash).slice(0, 12)}</code>
          </td>
        </tr>
      ))}
    </Table>
  );
}

// Its calls, each kind once with its number.
function summary(block: Block): string {
  if (block.transactions.length === 0) return block.events.length ? "rights that ended" : block.kind === "transactions" ? "empty" : block.kind;
  const counts = new Map<string, number>();
  for (const record of block.transactions) counts.set(callOf(record), (counts.get(callOf(record)) ?? 0) + 1);
  return [...counts].map(([call, count]) => (count > 1 ? `${count} × ${call}` : call)).join(", ");
}

// Rows of the audit about a robot or somebody.
function Found({ words }: { words: string }): JSX.Element {
  const question = words.includes("/") ? { user: words } : { robot: words };
  const { answer, error } = useAnswer(() => gateway.audit({ ...question, limit: ROWS }), [words]);
  if (error !== undefined) return <Refused error={error} />;
  if (!answer) return <Empty>Asking…</Empty>;
  if (answer.rows.length === 0) return <Empty>Nothing about “{words}”. A user is ORGANISATION/NAME.</Empty>;
  return (
    <>
      <p class="summary">
        {answer.rows.length} decisions about {words}
        {answer.more && ", the oldest first; there are more: ledgerctl audit"}
      </p>
      <Table label={`Decisions about ${words}`} head={["Time", "Decision", "About", "Who", "Detail", "Transaction"]}>
        {[...answer.rows].reverse().map((row, at) => (
          <tr key={at}>
            <td>{moment(row.time)}</td>
            <td>{row.count > 1n ? `${row.decision} ×${row.count}` : row.decision}</td>
            <td>{row.subject || row.robot}</td>
            <td>{row.who}</td>
            <td class="wide">
              {row.code > 0 && <code>{codeOf(row.code)}</code>} {row.detail}
            </td>
            <td>
              {row.transaction.length > 0 ? (
                <a href={address("tx", hex(row.transaction))}>
                  <code>{hex(row.transaction).slice(0, 12)}</code>
                </a>
              ) : (
                <a href={address("blocks", String(row.height))}>block {String(row.height)}</a>
              )}
            </td>
          </tr>
        ))}
      </Table>
    </>
  );
}

export function OneBlock({ height }: { height: string }): JSX.Element {
  const { answer: block, error } = useAnswer(() => gateway.getBlock({ height: BigInt(height) }), [height]);
  return (
    <Page title={`Block ${height}`}>
      {error !== undefined && <Refused error={error} />}
      {block && (
        <>
          <Facts>
            <Fact name="Time">{moment(block.time)}</Fact>
            <Fact name="Term">{String(block.term)}</Fact>
            <Fact name="Hash">
              <code>{hex(block.hash)}</code>
            </Fact>
            <Fact name="Block before">
              <a href={address("blocks", String(Math.max(0, Number(height) - 1)))}>
                <code>{hex(block.previousHash)}</code>
              </a>
            </Fact>
            <Fact name="Root of the transactions">
              <code>{hex(block.root)}</code>
            </Fact>
            <Fact name="State digest">
              <code>{hex(block.stateDigest)}</code>
            </Fact>
          </Facts>
          <h2>Transactions</h2>
          {block.transactions.length === 0 && <Empty>None: {block.kind}.</Empty>}
          {block.transactions.length > 0 && (
            <Table label="Transactions" head={["Position", "Call", "Signer", "Verdict", "Id"]}>
              {block.transactions.map((record) => (
                <tr key={hex(record.id)}>
                  <td>{record.index}</td>
                  <td class="wide">{callOf(record)}</td>
                  <td>{record.creator}</td>
                  <td>{record.verdict?.code ? <span class="what warn">{codeOf(record.verdict.code)}</span> : <span class="what good">executed</span>}</td>
                  <td>
                    <a href={address("tx", hex(record.id))}>
                      <code>{hex(record.id).slice(0, 16)}</code>
                    </a>
                  </td>
                </tr>
              ))}
            </Table>
          )}
          {block.events.length > 0 && (
            <>
              <h2>What the block itself did</h2>
              <ul>
                {block.events.map((event, at) => (
                  <li key={at}>
                    {event.name} {event.subject} <code>{text(event.payload)}</code>
                  </li>
                ))}
              </ul>
            </>
          )}
        </>
      )}
    </Page>
  );
}

export function OneTransaction({ id }: { id: string }): JSX.Element {
  const { answer: record, error } = useAnswer(() => gateway.getTransaction({ id: unhex(id) }), [id]);
  const body = record && bodyOf(record.transaction);
  return (
    <Page title="Transaction">
      {error !== undefined && <Refused error={error} />}
      {record && (
        <>
          <Facts>
            <Fact name="Id">
              <code>{id}</code>
            </Fact>
            <Fact name="Call">{callOf(record)}</Fact>
            <Fact name="Signer">{record.creator}</Fact>
            <Fact name="Block">
              <a href={address("blocks", String(record.height))}>{String(record.height)}</a>, position {record.index}, {moment(record.time)}
            </Fact>
            <Fact name="Verdict">
              {record.verdict?.code ? (
                <>
                  <code>{codeOf(record.verdict.code)}</code> {record.verdict.message}
                </>
              ) : (
                "executed"
              )}
            </Fact>
            {body && <Fact name="Good until">{moment(body.notAfter)}</Fact>}
          </Facts>
          {body && body.args.length > 0 && (
            <>
              <h2>Arguments</h2>
              <ol class="arguments">
                {body.args.map((each, at) => (
                  <li key={at}>
                    <code>{argument(each)}</code>
                  </li>
                ))}
              </ol>
            </>
          )}
          {record.events.length > 0 && (
            <>
              <h2>Events</h2>
              <ul>
                {record.events.map((event, at) => (
                  <li key={at}>
                    {event.name} {event.subject} <code>{argument(event.payload)}</code>
                  </li>
                ))}
              </ul>
            </>
          )}
          <TheProof id={unhex(id)} />
        </>
      )}
    </Page>
  );
}

function TheProof({ id }: { id: Bytes }): JSX.Element {
  const [proof, setProof] = useState<Proof>();
  const [error, setError] = useState<unknown>();
  const run = async () => setProof(await examine(own((await gateway.proveTransaction({ id })).link)));
  return (
    <section aria-label="Proof">
      <h2>Proof</h2>
      <p class="dim">
        The node gives a proof; this browser checks it. Whether the signers were the voters then, ledgerctl prove shows from the genesis on.
      </p>
      <div class="actions">
        <Action kind="main" run={run} refused={setError}>
          Check the proof
        </Action>
      </div>
      {error !== undefined && <Refused error={error} />}
      {proof && (
        <>
          <p class="summary" role="status">
            {proof.checks.every((check) => check.holds)
              ? `The proof holds: signed by ${proof.signers.join(", ")}.`
              : "A part of the proof does not hold."}
          </p>
          <ul class="checks">
            {proof.checks.map((check, at) => (
              <li key={at} class={check.holds ? "holds" : "fails"}>
                <span aria-hidden="true">{check.holds ? "✓" : "✗"}</span> {check.what}
                {!check.holds && " — does not hold"} {check.detail && <span class="dim">{check.detail}</span>}
              </li>
            ))}
          </ul>
        </>
      )}
    </section>
  );
}
