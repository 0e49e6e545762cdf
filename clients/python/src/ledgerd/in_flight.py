"""Transactions that have no verdict yet. They survive the connection: the next one sends all of them again, in their order."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from enum import Enum, auto
from typing import Final

from ledgerd.codes import Kind
from ledgerd.refusal import Refusal, of_verdict, refusal
from ledgerd.transaction import Prepared
from ledgerd.v1 import gateway_pb2 as api

ATTEMPT_MAX: Final = 3.0
"""After so many seconds without any answer, while one is due, the node counts as stuck, and another one is asked."""
RETRY_AFTER: Final = 0.1
"""How long a node that said "not now" is left in peace, in seconds."""
IN_FLIGHT_MAX: Final = 8192
"""Most transactions of one client in flight."""

# These are one node's trouble, and another one may have none of it.
_OWN: Final = {"BEHIND", "DISK_FULL"}
_ELSEWHERE: Final = {*_OWN, "NO_LEADER", "SHUTTING_DOWN", "UNREACHABLE", "CLOCK_OUT_OF_BOUNDS"}


@dataclass(frozen=True)
class Committed:
    """A transaction that was executed: its id, the height of its block, its position there, block time in microseconds, and
    the answer of the function. `certified`: enough voters have signed its block or a later one, as the node says; under a leader
    that lies, only certified outcomes are final.
    """

    id: bytes
    height: int
    index: int
    time: int
    response: bytes
    certified: bool = False


class Effect(Enum):
    """What an answer means for the connection."""

    NOTHING = auto()
    LEAVE = auto()
    DOUBT_CLOCK = auto()


class _State(Enum):
    WAITING = auto()
    SENT = auto()
    RESTING = auto()


@dataclass
class _Entry:
    transaction: Prepared
    certificate: bytes
    verdict: asyncio.Future[Committed]
    deadline: float
    state: _State = _State.WAITING
    sent_at: float = 0.0
    attempts: int = 0
    # Has no node got it that has not refused it for good?
    fresh: bool = True
    # Was it sent without any answer? Then it may have been executed, until a node says what became of it.
    uncertain: bool = False
    refused: Refusal | None = None
    # Was it sent with the certificate because a node asked for it?
    is_introduced: bool = False


@dataclass
class InFlight:
    """The transactions of one client. `several` says whether there is another node to go to, and `introduced` is the
    certificate that the ledger is known to have.
    """

    several: bool = False
    introduced: bytes | None = None
    _entries: dict[bytes, _Entry] = field(default_factory=dict)
    _send: Callable[[api.SubmitRequest], None] | None = None
    _answered: float = 0.0
    _resting_until: float | None = None
    _closed: Refusal | None = None

    def add(self, transaction: Prepared, certificate: bytes, patience: float) -> asyncio.Future[Committed]:
        """Takes a transaction in and sends it, now or with the next connection."""
        if self._closed is not None:
            raise self._closed
        if len(self._entries) >= IN_FLIGHT_MAX:
            raise refusal(
                "OVERLOADED",
                "too many transactions wait for their verdict",
                found=f"{len(self._entries)} waiting",
                wanted=f"at most {IN_FLIGHT_MAX}",
                next="submit less often, or several messages in one transaction",
            )
        verdict = asyncio.get_running_loop().create_future()
        entry = _Entry(transaction, certificate, verdict, time.monotonic() + patience)
        self._entries[transaction.id] = entry
        if self._resting_until is not None:
            # It must not overtake those that rest: a command that comes after its successor is refused.
            entry.state = _State.RESTING
        else:
            self._put(entry)
        return verdict

    def attach(self, send: Callable[[api.SubmitRequest], None]) -> None:
        """A connection is open: everything that waits goes there."""
        self._send = send
        self._put_all(self._entries.values())

    def detach(self) -> None:
        """The connection broke: what was sent over it may be executed or not."""
        self._send = None
        for entry in self._entries.values():
            entry.uncertain |= entry.state is _State.SENT
            entry.state = _State.WAITING

    def answer(self, answer: api.SubmitResponse) -> Effect:
        """Takes an answer and tells it, unless it calls for another attempt."""
        self._answered = time.monotonic()
        entry = self._entries.get(answer.id)
        if entry is None:
            return Effect.NOTHING
        refused = of_verdict(answer.verdict)
        effect = Effect.NOTHING
        if refused is not None and answer.height == 0:
            own = self.several and refused.name in _OWN
            if own or refused.kind is Kind.UNREACHABLE:
                # The node's own "outcome unknown" means that it did take it.
                entry.uncertain |= refused.name == "TIMEOUT"
                entry.refused, entry.state = refused, _State.RESTING
                if self._resting_until is None:
                    self._resting_until = time.monotonic() + RETRY_AFTER
                return Effect.LEAVE if refused.name in _ELSEWHERE else Effect.NOTHING
            if refused.name == "UNKNOWN_CREATOR" and not entry.is_introduced:
                self.introduced, entry.is_introduced = None, True
                entry.transaction = entry.transaction.introduced(entry.certificate)
                entry.fresh = entry.attempts == 1
                self._put(entry)
                return Effect.NOTHING
            if refused.name in ("EXPIRED", "NOT_AFTER_TOO_FAR"):
                effect = Effect.DOUBT_CLOCK
        del self._entries[answer.id]
        if refused is None:
            self.introduced = entry.certificate
            done = Committed(answer.id, answer.height, answer.index, answer.time, answer.response)
            _resolve(entry, done)
        elif entry.uncertain and answer.height == 0 and not refused.is_final:
            _resolve(entry, _unknown(entry, refused.message))
        else:
            _resolve(entry, refused)
        return effect

    def sweep(self, broken: Refusal | None) -> bool:
        """Gives up what is too late, and sends again what has rested. Is the node stuck?"""
        now = time.monotonic()
        hopeless = broken is not None and broken.kind is not Kind.UNREACHABLE
        for id, entry in [*self._entries.items()]:
            if entry.verdict.done():
                # Nobody waits for it any more; a copy may be on its way all the same.
                del self._entries[id]
            elif hopeless or entry.deadline <= now:
                del self._entries[id]
                _resolve(entry, _given_up(entry, broken))
        if self._resting_until is not None and self._resting_until <= now:
            self._resting_until = None
            self._put_all(entry for entry in self._entries.values() if entry.state is _State.RESTING)
        if self._answered + ATTEMPT_MAX > now:
            return False
        return any(one.state is _State.SENT and one.sent_at + ATTEMPT_MAX <= now for one in self._entries.values())

    def close(self, reason: Refusal) -> None:
        """Nobody sends anything any more."""
        self._closed = reason
        for entry in self._entries.values():
            sent = entry.uncertain or entry.state is _State.SENT
            _resolve(entry, _unknown(entry, reason.message) if sent else reason)
        self._entries.clear()

    def _put_all(self, entries: Iterable[_Entry]) -> None:
        self._resting_until = None
        # The table keeps the order in which they came.
        for entry in [*entries]:
            self._put(entry)

    def _put(self, entry: _Entry) -> None:
        if self._send is None:
            entry.state = _State.WAITING
            return
        # The height is added by whoever writes it to the wire: it is the newest one then.
        request = api.SubmitRequest(transaction=entry.transaction.encoded, first_attempt=entry.fresh)
        entry.fresh, entry.state, entry.sent_at = False, _State.SENT, time.monotonic()
        entry.attempts += 1
        self._send(request)


def _resolve(entry: _Entry, outcome: Committed | Refusal) -> None:
    if entry.verdict.done():
        return
    if isinstance(outcome, Committed):
        entry.verdict.set_result(outcome)
    else:
        entry.verdict.set_exception(outcome)


def _given_up(entry: _Entry, broken: Refusal | None) -> Refusal:
    reason = broken or entry.refused
    if entry.uncertain or entry.state is _State.SENT:
        return _unknown(entry, reason.message if reason else "the node did not answer")
    return reason or refusal("UNREACHABLE", "no node accepted the transaction")


def _unknown(entry: _Entry, why: str) -> Refusal:
    id = entry.transaction.id.hex()
    return refusal(
        "TIMEOUT",
        f"no verdict in time; the outcome is unknown, the id is {id}",
        found=f"sent {entry.attempts} times; {why}",
        wanted="a verdict",
        next=f"ledgerctl tx {id}",
    )
