// Encodes transactions as a browser does. Cases come on standard input, one JSON object a line, bytes in hexadecimal digits; for each
// there is a line with the encoded body and one with the encoded transaction: node tests/transaction.mjs
import assert from "node:assert/strict";
import { readFileSync } from "node:fs";
import { hex, unhex } from "../data/bytes.js";
import { encodeBody, encodeTransaction, fields } from "../data/transaction.js";

for (const line of readFileSync(0, "utf8").trim().split("\n")) {
  const { network, creator, nonce, not_after: notAfter, chaincode, function: name, args, signature, certificate } = JSON.parse(line);
  const [one, two, three] = [network, creator, nonce].map(unhex);
  const body = encodeBody({ network: one, creator: two, nonce: three, notAfter: BigInt(notAfter), chaincode, function: name, args: args.map(unhex) });
  const transaction = encodeTransaction({ body, signature: unhex(signature), certificate: unhex(certificate) });
  // What is read back is what was written.
  assert.equal(hex(fields(transaction).get(1) ?? new Uint8Array()), hex(body));
  assert.equal(hex(fields(body).get(2) ?? new Uint8Array()), creator);
  console.log(hex(body));
  console.log(hex(transaction));
}

// Bytes that end too early, and kinds of fields that no transaction has, are no message.
for (const broken of ["0a", "0a05ff", "0aff", "0aff".padEnd(30, "f"), "0d00000000"]) assert.throws(() => fields(unhex(broken)), broken);
