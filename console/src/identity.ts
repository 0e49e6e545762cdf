// The identity of this browser: a key that no script can read, and its certificate, kept by the browser for this origin.

import { type Bytes, hex, sha256 } from "./bytes";
import { certificate, signature, signingRequest } from "./der";

const KEY_KIND = { name: "ECDSA", namedCurve: "P-256" };
const SIGNING = { name: "ECDSA", hash: "SHA-256" };

const DATABASE = "ledgerd";
const STORE = "identity";
const OWN = "own";

export interface Identity {
  key: CryptoKey;
  certificate: Bytes;
  organisation: string;
  name: string;
  // Name of the network, hexadecimal: a console of another network is refused.
  network: string;
}

export const idOf = (identity: Identity): string => `${identity.organisation}/${identity.name}`;
export const endOf = (identity: Identity): number => certificate(identity.certificate).notAfter;
export const creatorOf = (identity: Identity): Promise<Bytes> => sha256(identity.certificate);

export async function sign(key: CryptoKey, bytes: Bytes): Promise<Bytes> {
  return signature(new Uint8Array(await crypto.subtle.sign(SIGNING, key, bytes)));
}

export interface NewKey {
  key: CryptoKey;
  request: Bytes;
}

// A new key that cannot leave the browser, and a request for its certificate.
export async function makeKey(name: string): Promise<NewKey> {
  const pair = await crypto.subtle.generateKey(KEY_KIND, false, ["sign", "verify"]);
  const spki = new Uint8Array(await crypto.subtle.exportKey("spki", pair.publicKey));
  return { key: pair.privateKey, request: await signingRequest(name, spki, (bytes) => sign(pair.privateKey, bytes)) };
}

function database(): Promise<IDBDatabase> {
  return new Promise((resolve, reject) => {
    const opening = indexedDB.open(DATABASE, 1);
    opening.onupgradeneeded = () => opening.result.createObjectStore(STORE);
    opening.onsuccess = () => resolve(opening.result);
    opening.onerror = () => reject(opening.error);
  });
}

async function kept<T>(mode: IDBTransactionMode, work: (store: IDBObjectStore) => IDBRequest<T>): Promise<T> {
  const open = await database();
  try {
    return await new Promise<T>((resolve, reject) => {
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

export const load = (): Promise<Identity | undefined> => kept("readonly", (store) => store.get(OWN));
export const save = (identity: Identity): Promise<unknown> => kept("readwrite", (store) => store.put(identity, OWN));
export const forget = (): Promise<unknown> => kept("readwrite", (store) => store.delete(OWN));

export const fingerprint = (digest: Uint8Array): string => hex(digest).slice(0, 16);
