// The identity of this browser: a key that no script can read, and its certificate, kept by the browser for this origin.

import { sha256 } from "./bytes.js";
import { certificate, signature, signingRequest } from "./der.js";

/** @typedef {import("./bytes.js").Bytes} Bytes */

/**
 * `network` is the name of the network in hexadecimal digits: a console of another network is rejected.
 * @typedef {{ key: CryptoKey, certificate: Bytes, organisation: string, name: string, network: string }} Identity
 */

const KEY_KIND = { name: "ECDSA", namedCurve: "P-256" };
const SIGNING = { name: "ECDSA", hash: "SHA-256" };

const DATABASE = "ledgerd";
const STORE = "identity";
const OWN = "own";

/** @param {Identity} identity */
export const idOf = (identity) => `${identity.organisation}/${identity.name}`;
/** @param {Identity} identity */
export const endOf = (identity) => certificate(identity.certificate).notAfter;
/** @param {Identity} identity */
export const creatorOf = (identity) => sha256(identity.certificate);

/** @param {CryptoKey} key @param {Bytes} bytes */
export const sign = async (key, bytes) => signature(new Uint8Array(await crypto.subtle.sign(SIGNING, key, bytes)));

/** A new key that cannot leave the browser, and a request for its certificate. @param {string} name */
export async function makeKey(name) {
  const pair = await crypto.subtle.generateKey(KEY_KIND, false, ["sign", "verify"]);
  const spki = new Uint8Array(await crypto.subtle.exportKey("spki", pair.publicKey));
  return { key: pair.privateKey, request: await signingRequest(name, spki, (bytes) => sign(pair.privateKey, bytes)) };
}

/** @returns {Promise<IDBDatabase>} */
function database() {
  return new Promise((resolve, reject) => {
    const opening = indexedDB.open(DATABASE, 1);
    opening.onupgradeneeded = () => opening.result.createObjectStore(STORE);
    opening.onsuccess = () => resolve(opening.result);
    opening.onerror = () => reject(opening.error);
  });
}

/**
 * @template T
 * @param {IDBTransactionMode} mode
 * @param {(store: IDBObjectStore) => IDBRequest<T>} work
 * @returns {Promise<T>}
 */
async function kept(mode, work) {
  const open = await database();
  try {
    return await new Promise((resolve, reject) => {
      const transaction = open.transaction(STORE, mode);
      const request = work(transaction.objectStore(STORE));
      transaction.oncomplete = () => resolve(request.result);
      transaction.onerror = () => reject(transaction.error);
      transaction.onabort = () => reject(transaction.error);
    });
  } finally {
    open.close();
  }
}

/** @returns {Promise<Identity | undefined>} */
export const load = () => kept("readonly", (store) => store.get(OWN));
/** @param {Identity} identity */
export const save = (identity) => kept("readwrite", (store) => store.put(identity, OWN));
export const forget = () => kept("readwrite", (store) => store.delete(OWN));
