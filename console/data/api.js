// The HTTP API of the node (docs/http.md): JSON, streams of JSON lines, and rejections in their four parts.

/** @typedef {import("./bytes.js").Bytes} Bytes */
/** @typedef {Record<string, string | number | boolean | string[] | undefined>} Parameters */

export class Rejection extends Error {
  /**
   * @param {{ message?: string, code?: string, found?: string, wanted?: string, next?: string }} parts
   * @param {number} status of HTTP; 0: there was no answer
   */
  constructor({ message = "the node does not answer", code = "", found = "", wanted = "", next = "" }, status = 0) {
    super(message);
    this.code = code;
    this.found = found;
    this.wanted = wanted;
    this.next = next;
    this.status = status;
  }
}

/** @param {unknown} error */
export function rejectionOf(error) {
  if (error instanceof Rejection) return error;
  return new Rejection({ message: error instanceof Error ? error.message : String(error) });
}

/** The session of this page has ended. @param {unknown} error */
export const hasEnded = (error) => error instanceof Rejection && error.status === 401;

/** This identity may not. @param {unknown} error */
export const isDenied = (error) => error instanceof Rejection && error.status === 403;

// The token of the session: in this module's memory alone, so it ends with the page.
let token = "";
/** @type {() => void} */
let ended = () => undefined;

/** @param {string} opened */
export function useSession(opened) {
  token = opened;
}

export const session = () => token;

/** @param {() => void} listener called when the session has ended */
export function onEnd(listener) {
  ended = listener;
}

/**
 * @param {string} path
 * @param {Parameters} parameters
 */
function address(path, parameters) {
  const query = new URLSearchParams();
  for (const [name, value] of Object.entries(parameters)) {
    for (const each of Array.isArray(value) ? value : value ? [value] : []) query.append(name, String(each));
  }
  return query.size ? `${path}?${query}` : path;
}

/**
 * @param {string} path
 * @param {RequestInit} options
 */
async function ask(path, options) {
  /** @type {Record<string, string>} */
  const headers = { ...(token ? { authorization: `Session ${token}` } : {}), .../** @type {any} */ (options.headers) };
  const used = token;
  const answer = await fetch(path, { ...options, headers, credentials: "omit", cache: "no-store" }).catch((error) => {
    if (options.signal?.aborted) throw error;
    throw new Rejection({ found: String(error) });
  });
  if (answer.ok) return answer;
  const parts = await answer.json().catch(() => ({ message: `the node answers with status ${answer.status}` }));
  if (answer.status === 401 && used && used === token) {
    token = "";
    ended();
  }
  throw new Rejection(parts, answer.status);
}

/**
 * @template T
 * @param {string} path
 * @param {Parameters} parameters
 * @returns {Promise<T>}
 */
export async function get(path, parameters = {}) {
  return (await ask(address(path, parameters), {})).json();
}

/**
 * @template T
 * @param {string} path
 * @param {unknown} body
 * @returns {Promise<T>}
 */
export async function post(path, body) {
  return (await ask(path, { method: "POST", headers: { "content-type": "application/json" }, body: JSON.stringify(body) })).json();
}

/**
 * @template T
 * @param {string} path
 * @param {Parameters} parameters
 * @param {Bytes} body
 * @returns {Promise<T>}
 */
export async function postBytes(path, parameters, body) {
  const headers = { "content-type": "application/octet-stream" };
  return (await ask(address(path, parameters), { method: "POST", headers, body })).json();
}

/**
 * The lines of a stream, until it ends. Its last line may be a rejection, which is thrown.
 * @template T
 * @param {string} path
 * @param {Parameters} parameters
 * @param {AbortSignal} signal
 * @param {() => void} opened called when the node has answered
 * @returns {AsyncGenerator<T, void>}
 */
export async function* lines(path, parameters, signal, opened = () => undefined) {
  const answer = await ask(address(path, parameters), { signal });
  opened();
  const reader = /** @type {ReadableStream<Uint8Array>} */ (answer.body).getReader();
  const decoder = new TextDecoder();
  let rest = "";
  for (;;) {
    const { done, value } = await reader.read();
    if (done) return;
    const parts = (rest + decoder.decode(value, { stream: true })).split("\n");
    rest = parts.pop() ?? "";
    for (const part of parts) {
      const line = JSON.parse(part);
      if (line.code) throw new Rejection(line, line.status);
      yield line;
    }
  }
}
