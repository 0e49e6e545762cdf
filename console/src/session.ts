// The session of this page with the node. Its token is in this module's memory alone, and so ends with the page.

import { createClient, type Client, type Interceptor } from "@connectrpc/connect";
import { createGrpcWebTransport } from "@connectrpc/connect-web";
import { concat, hex, part, unhex, utf8 } from "./bytes";
import { Enrolment } from "./gen/ledgerd/v1/enrolment_pb";
import { Gateway } from "./gen/ledgerd/v1/gateway_pb";
import { type Identity, forget, makeKey, save, sign } from "./identity";
import { Refusal, accepted, hasEnded } from "./refusal";

let token = "";
const listeners = new Set<() => void>();

// Tells when the session has ended.
export function onEnd(listener: () => void): void {
  listeners.add(listener);
}

function ended(): void {
  token = "";
  for (const listener of listeners) listener();
}

const authorise: Interceptor = (next) => async (request) => {
  if (token) request.header.set("authorization", `Session ${token}`);
  try {
    return await next(request);
  } catch (error) {
    if (hasEnded(error) && token) ended();
    throw error;
  }
};

const transport = createGrpcWebTransport({ baseUrl: location.origin, interceptors: [authorise] });
export const gateway: Client<typeof Gateway> = createClient(Gateway, transport);
const enrolment: Client<typeof Enrolment> = createClient(Enrolment, transport);

async function post<T>(path: string, body: unknown): Promise<T> {
  const answer = await fetch(path, {
    method: "POST",
    headers: { "content-type": "application/json" },
    body: JSON.stringify(body),
    credentials: "omit",
  });
  const told = await answer.json();
  if (!answer.ok) throw new Refusal(told.message, told.code, told.found, told.wanted, told.next);
  return told as T;
}

interface Challenge {
  network: string;
  node: string;
  challenge: string;
}

export interface Session {
  session: string;
  id: string;
  role: string;
  attributes: Record<string, string>;
}

// Opens a session as this identity: its key signs the node's challenge, for this origin.
export async function open(identity: Identity): Promise<Session> {
  const { network, node, challenge } = await post<Challenge>("/session/challenge", {});
  if (network !== identity.network) {
    throw new Refusal("this console belongs to another network", "", network, identity.network, "forget this identity, and ask an admin for a new link");
  }
  const prefix = utf8("ledgerd console session v1\0");
  const signed = concat(prefix, unhex(network), part(utf8(node)), part(utf8(location.origin)), part(unhex(challenge)));
  const opened = await post<Session>("/session/open", {
    certificate: hex(identity.certificate),
    challenge,
    signature: hex(await sign(identity.key, signed)),
  });
  token = opened.session;
  return opened;
}

// Ends the session, also while the page goes away.
export function close(): void {
  if (!token) return;
  const headers = { authorization: `Session ${token}` };
  token = "";
  void fetch("/session/end", { method: "POST", headers, keepalive: true, credentials: "omit" }).catch(() => undefined);
}

// Makes the key of this browser, and exchanges the secret of a link for its certificate.
export async function enrol(organisation: string, name: string, secret: string): Promise<Identity> {
  const { key, request } = await makeKey(name);
  const answer = await enrolment.enrol({ name: `${organisation}/${name}`, secret, request });
  accepted(answer.verdict);
  const network = hex(answer.network!.network);
  const identity: Identity = { key, certificate: Uint8Array.from(answer.certificate), organisation: answer.organisation, name, network };
  await save(identity);
  return identity;
}

export async function abandon(): Promise<void> {
  close();
  await forget();
}
