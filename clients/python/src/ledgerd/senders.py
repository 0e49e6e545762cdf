"""Those who sign messages: no node is believed about what a sender has signed."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

from cryptography import x509
from google.protobuf.message import DecodeError

from ledgerd import certificate
from ledgerd.context import Context
from ledgerd.refusal import Refusal, refusal
from ledgerd.rclpy_messages import deserialize
from ledgerd.transaction import PREFIX, verify
from ledgerd.v1 import gateway_pb2 as api
from ledgerd.v1 import transaction_pb2 as signed

ABAC: Final = "abac"
_ARGS_BEFORE_PAYLOADS: Final = 3
_KNOWN_MAX: Final = 4096
# The first bytes of an envelope, in which messages of confidential services travel. No CDR begins so.
_ENVELOPE: Final = b"\xe5\x01"


@dataclass(frozen=True)
class Message:
    """A message that was executed. Its sender has signed it, and the signature was checked here.

    height, index   its block, and its transaction in the block
    time            block time, microseconds since the UNIX epoch
    service, sender such as `Turtlebot4/cmd_vel` and `Org1/Salma`
    epoch, seq      the grant under which it was sent, and its number
    payload         CDR with its header of four bytes
    transaction     the id of the transaction
    """

    height: int
    time: int
    index: int
    service: str
    sender: str
    epoch: int
    seq: int
    payload: bytes
    transaction: bytes

    def decode(self, message_type: type[Any]) -> Any:
        """The message as an object of a message class of rclpy."""
        return deserialize(self.payload, message_type)


class Senders:
    """Checks signatures. A stream shows each certificate once, with the first transaction of its owner."""

    def __init__(self, context: Context) -> None:
        self._context = context
        self._known: dict[bytes, tuple[str, x509.Certificate]] = {}

    def messages(self, delivery: api.Delivery, event: api.EventRecord) -> list[Message]:
        """The messages of one event, as their sender has signed them."""
        told = _told(event.payload)
        try:
            transaction = signed.Transaction.FromString(event.transaction)
            body = signed.TransactionBody.FromString(transaction.body)
        except DecodeError as error:
            raise _malformed(f"bytes that are no transaction: {error}") from error
        sender = self._check(transaction, body, event.certificate)
        if body.chaincode != ABAC or body.function != "set":
            # A chaincode of somebody's own may publish on behalf of its caller; its arguments are not ours to read.
            return []
        payloads = body.args[_ARGS_BEFORE_PAYLOADS:]
        words = [arg.decode(errors="replace") for arg in body.args[:_ARGS_BEFORE_PAYLOADS]]
        robot, _, _ = event.subject.partition("/")
        # A robot with one service is named alone.
        names = words[:1] in ([event.subject], [robot])
        numbers = [str(told[name]) for name in ("epoch", "first_seq")]
        if body.network != self._context.network or not names or words[1:] != numbers or len(payloads) != told["count"]:
            raise _malformed(f"signed for {' '.join(words)}, {len(payloads)} messages")
        if any(payload.startswith(_ENVELOPE) for payload in payloads):
            raise _encrypted(event.subject)
        id = hashlib.sha256(transaction.body).digest()
        place = (delivery.height, delivery.time, event.index, event.subject, sender, told["epoch"])
        return [Message(*place, told["first_seq"] + number, payload, id) for number, payload in enumerate(payloads)]

    def _check(self, transaction: signed.Transaction, body: signed.TransactionBody, shown: bytes) -> str:
        known = self._known.get(body.creator)
        if known is None and shown and hashlib.sha256(shown).digest() == body.creator:
            known = certificate.signer(shown, self._context.organisations)
            if len(self._known) >= _KNOWN_MAX:
                self._known.clear()
            self._known[body.creator] = known
        if known is None:
            raise refusal(
                "UNKNOWN_CREATOR",
                f"the signer of transaction {hashlib.sha256(transaction.body).hexdigest()} is not known",
                found=f"no certificate with fingerprint {body.creator.hex()}",
                wanted="the certificate with the first message of a sender",
                next="the node left it out: ask another node",
            )
        name, owner = known
        verify(owner.public_key(), transaction.signature, PREFIX + transaction.body)
        return name


def _told(payload: bytes) -> Mapping[str, int]:
    try:
        told = json.loads(payload)
        return {name: int(told[name]) for name in ("epoch", "first_seq", "count")}
    except (KeyError, TypeError, ValueError) as error:
        raise _malformed(f"an event that is none: {error}") from error


def _encrypted(service: str) -> Refusal:
    return refusal(
        "BAD_MESSAGE",
        f"messages of {service} are encrypted, and this client does not decrypt",
        found="an envelope of a confidential service",
        wanted="a service without confidential=true",
        next=f"read it with a bridge, or with: ledgerctl echo {service}",
    )


def _malformed(found: str) -> Refusal:
    return refusal(
        "MALFORMED",
        "the node says something else of a message than its sender has signed",
        found=found,
        wanted="what the sender has signed",
        next="ask another node, and look into the logs of this one",
    )
