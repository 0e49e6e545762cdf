// The session of this page with the node, and how a browser gets an identity.

import { Rejection, post, session, useSession } from "./api.js";
import { concat, hex, part, unhex, utf8 } from "./bytes.js";
import { forget, makeKey, save, sign } from "./identity.js";

/** @typedef {import("./identity.js").Identity} Identity */
/** @typedef {{ session: string, id: string, role: string, attributes: Record<string, string> }} Session */

/** The begin of what is signed to open a session. */
const PREFIX = utf8("ledgerd console session v1\0");

/**
 * Opens a session as this identity: its key signs the node's challenge, for this origin.
 * @param {Identity} identity
 * @returns {Promise<Session>}
 */
export async function open(identity) {
  /** @type {{ network: string, node: string, challenge: string }} */
  const { network, node, challenge } = await post("/session/challenge", {});
  if (network !== identity.network) {
    const message = "this console belongs to another network";
    throw new Rejection({ message, found: network, wanted: identity.network, next: "forget this identity, and ask an admin for a new link" });
  }
  const signed = concat(PREFIX, unhex(network), part(utf8(node)), part(utf8(location.origin)), part(unhex(challenge)));
  /** @type {Session} */
  const opened = await post("/session/open", {
    certificate: hex(identity.certificate),
    challenge,
    signature: hex(await sign(identity.key, signed)),
  });
  useSession(opened.session);
  return opened;
}

/** Ends the session, also while the page goes away. */
export function close() {
  const token = session();
  if (!token) return;
  useSession("");
  const headers = { authorization: `Session ${token}` };
  void fetch("/session/end", { method: "POST", headers, keepalive: true, credentials: "omit" }).catch(() => undefined);
}

/**
 * Makes the key of this browser, and exchanges the secret of a link for its certificate.
 * @param {string} organisation
 * @param {string} name
 * @param {string} secret
 * @returns {Promise<Identity>}
 */
export async function enrol(organisation, name, secret) {
  const { key, request } = await makeKey(name);
  /** @type {{ organisation: string, certificate: string, network: { network: string } }} */
  const answer = await post("/v1/enrol", { name: `${organisation}/${name}`, secret, request: hex(request) });
  const identity = { key, certificate: unhex(answer.certificate), organisation: answer.organisation, name, network: answer.network.network };
  await save(identity);
  return identity;
}

export async function abandon() {
  close();
  await forget();
}
