// Refusals, in their four parts.

import { ConnectError, Code } from "@connectrpc/connect";
import type { Verdict } from "./gen/ledgerd/v1/gateway_pb";

export class Refusal extends Error {
  constructor(
    message: string,
    readonly code: string,
    readonly found = "",
    readonly wanted = "",
    readonly next = "",
  ) {
    super(message);
  }
}

export const codeOf = (number: number): string => (number ? `LGR-${number}` : "");

// Throws unless it was executed.
export function accepted(verdict: Verdict | undefined): void {
  if (!verdict || verdict.code === 0) return;
  throw new Refusal(verdict.message, codeOf(verdict.code), verdict.found, verdict.wanted, verdict.next);
}

// The session of this page has ended.
export const hasEnded = (error: unknown): boolean => error instanceof ConnectError && error.code === Code.Unauthenticated;

// This identity may not.
export const isDenied = (error: unknown): boolean => error instanceof ConnectError && error.code === Code.PermissionDenied;

export function refusal(error: unknown): Refusal {
  if (error instanceof Refusal) return error;
  if (error instanceof ConnectError) {
    const [message = "", ...lines] = error.rawMessage.split("\n");
    const of = (word: string): string => lines.map((line) => line.trim()).find((line) => line.startsWith(`${word} `))?.slice(word.length).trim() ?? "";
    const code = /\[(LGR-\d+)\]/.exec(error.rawMessage)?.[1] ?? "";
    const shown = message.replace(/\s*\[LGR-\d+\]\s*$/, "").replace(/^error: /, "");
    return new Refusal(shown || "the node does not answer", code, of("found"), of("wanted"), of("try"));
  }
  return new Refusal(error instanceof Error ? error.message : String(error), "");
}
