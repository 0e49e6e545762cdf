// Messages of a service as they come: rate, latency, and the last ones decoded.

import { fromBinary } from "@bufbuild/protobuf";
import { TransactionBodySchema, TransactionSchema } from "./gen/ledgerd/v1/transaction_pb";
import { text } from "./bytes";
import { now } from "./ledger";
import { shown } from "./payload";
import { hasEnded, isDenied } from "./refusal";
import { gateway } from "./session";

// Bridges and ledgerctl sign a message for so long, microseconds: so its signature says when it was made.
const SIGNED_FOR = 2_000_000;
const LAST_MAX = 12;
const AGAIN_MS = 1000;
export const WINDOW_S = 60;

export interface Message {
  at: number;
  seq: number;
  epoch: number;
  latencyMs: number;
  words: string;
}

// One point of the charts for each second.
export interface Second {
  at: number;
  count: number;
  latencies: number[];
}

export function quantile(sorted: number[], part: number): number | undefined {
  if (sorted.length === 0) return undefined;
  return sorted[Math.min(sorted.length - 1, Math.floor(sorted.length * part))];
}

export class Messages {
  readonly last: Message[] = [];
  readonly seconds: Second[] = [];
  private stop = new AbortController();

  constructor(
    private readonly service: string,
    private readonly isTwist: boolean,
    private readonly changed: () => void,
    private readonly failed: (error: unknown) => void,
  ) {
    void this.follow();
  }

  end(): void {
    this.stop.abort();
  }

  private async follow(): Promise<void> {
    const { signal } = this.stop;
    while (!signal.aborted) {
      try {
        const asked = { chaincode: "abac", subjects: [this.service], names: ["message"], heartbeatMs: 1000 };
        for await (const delivery of gateway.subscribe(asked, { signal })) {
          this.tick();
          for (const event of delivery.events) this.heard(text(event.payload), event.transaction);
          this.changed();
        }
      } catch (error) {
        if (signal.aborted || hasEnded(error)) return;
        this.failed(error);
        // A right that is missing does not come back by asking, and each question would be a refusal in the books.
        if (isDenied(error)) return;
      }
      await new Promise((resolve) => setTimeout(resolve, AGAIN_MS));
    }
  }

  private heard(json: string, encoded: Uint8Array): void {
    const { epoch, first_seq: seq, count } = JSON.parse(json) as { epoch: number; first_seq: number; count: number };
    const body = fromBinary(TransactionBodySchema, fromBinary(TransactionSchema, encoded).body);
    const latencyMs = Math.max(0, (now() - (Number(body.notAfter) - SIGNED_FOR)) / 1000);
    const words = shown(body.args[body.args.length - 1] ?? new Uint8Array(), this.isTwist);
    this.last.unshift({ at: Date.now() * 1000, seq: seq + count - 1, epoch, latencyMs, words });
    this.last.length = Math.min(this.last.length, LAST_MAX);
    const second = this.tick();
    second.count += count;
    second.latencies.push(latencyMs);
  }

  // The second that runs, with empty ones for those in which nothing came.
  private tick(): Second {
    const at = Math.floor(Date.now() / 1000);
    const newest = this.seconds[this.seconds.length - 1];
    for (let next = newest ? newest.at + 1 : at; next <= at; next += 1) this.seconds.push({ at: next, count: 0, latencies: [] });
    while (this.seconds.length > WINDOW_S) this.seconds.shift();
    return this.seconds[this.seconds.length - 1]!;
  }
}
