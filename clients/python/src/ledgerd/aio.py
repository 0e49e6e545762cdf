"""The client for programs with asyncio.

    async with await ledgerd.aio.connect("Salma") as robot:
        async with robot.acquire("Turtlebot4/cmd_vel", wait=30) as grant:
            await grant.publish(twist)
"""

from __future__ import annotations

import asyncio
import dataclasses
import json
import time
from collections.abc import Sequence
from pathlib import Path
from types import TracebackType
from typing import Any, Final

from ledgerd.codes import Kind
from ledgerd.context import Context
from ledgerd.events import Deliveries, Events, Messages, Wanted
from ledgerd.grant import COMMAND_TTL, Acquiring, Asked, Grant, Published, payloads
from ledgerd.in_flight import Committed
from ledgerd.process import Process
from ledgerd.refusal import Refusal, of_verdict, refusal
from ledgerd.renewal import renew_if_due
from ledgerd.senders import ABAC, Senders
from ledgerd.session import CONNECT_MAX, Session
from ledgerd.spans import scaled
from ledgerd.transaction import Call, prepare
from ledgerd.v1 import gateway_pb2 as api

DEADLINE: Final = 10.0
"""How long a call is tried, through one node after another, until it fails; seconds."""
TTL: Final = 30.0
"""How long after now a call may still be executed, in seconds. Longer than the deadline, or a late retry expires instead of
being answered.
"""

CERTIFIED_WITHIN: Final = 2.0
"""How long a call waits until its outcome is certified, in seconds."""

_ANSWER: Final = 1.0
"""Time for the question whether it is, besides, in seconds."""
_AGAIN: Final = 0.5
"""Pause before a stop that is not in force is signed and sent again, in seconds."""
_BY_TIME: Final = ("EXPIRED", "NOT_AFTER_TOO_FAR")
"""Refused for its time: it is never executed."""
_NAMED_MAX: Final = 64
"""Most calls that a resume names."""

__all__ = ["Acquiring", "Client", "Context", "Grant", "connect"]


async def connect(context: Context | str | None = None, *, home: Path | None = None, deadline: float = DEADLINE) -> Client:
    """Connects as a stored identity, to whichever node of its network serves; without a name as the selected one."""
    stored = context if isinstance(context, Context) else Context.load(context, home)
    client = Client(stored, deadline)
    await client.open()
    return client


class Client:
    """A connection to a network as one identity. It belongs to one event loop and one process."""

    def __init__(self, context: Context, deadline: float) -> None:
        self._session = Session(context, deadline)
        self._process = Process()
        # By service, in seconds.
        self._max_ages: dict[str, float] = {}

    async def open(self) -> None:
        """Connects. A certificate in the last third of its life is renewed now."""
        await self._session.start()
        await renew_if_due(self._session)

    @property
    def context(self) -> Context:
        """The identity, and what is known of the network by now."""
        return self._session.context

    @property
    def node(self) -> str | None:
        """Address of the node that it is connected to."""
        return self._session.node

    def now(self) -> int:
        """The node's clock now, microseconds since the UNIX epoch: what transactions are dated by."""
        return self._session.now()

    async def call(
        self, chaincode: str, function: str, *args: bytes, ttl: float = TTL, certified: float = CERTIFIED_WITHIN
    ) -> Committed:
        """Signs a call, submits it and waits for its verdict; raises that if it is a refusal, and `Unreachable` (TIMEOUT) if
        the outcome is unknown. It is executed once, through however many nodes it goes. Then it waits at most `certified` seconds
        until the outcome is certified, where the network certifies. It raises CONTRADICTED if a node has executed it and the
        network does not have it.
        """
        done = await self._executed(chaincode, function, args, ttl)
        try:
            known = await asyncio.wait_for(self.certified(done.id, certified), certified + _ANSWER)
            return dataclasses.replace(done, certified=known)
        except asyncio.TimeoutError:
            return done
        except Refusal as refused:
            if refused.name not in ("NOT_FOUND", "PRUNED"):
                # Nobody answers that question now.
                return done
        id = done.id.hex()
        raise refusal(
            "CONTRADICTED",
            f"transaction {id} was executed by a node, but is not part of the network's chain",
            found=f"an answer for block {done.height} that is not certified",
            wanted="a certified outcome",
            next="check ledgerctl network status, and repeat calls that are still wanted",
        )

    async def certified(self, id: bytes, within: float = CERTIFIED_WITHIN) -> bool:
        """Waits at most so many seconds until a transaction is certified, as the node says. Is it?"""
        self._process.check()
        request = api.GetTransactionRequest(id=id, certified_within_ms=scaled("within", within, 1000))
        record = await self._session.ask(lambda link: link.ask(link.get_transaction, request, CONNECT_MAX))
        return bool(record.certified)

    async def _executed(self, chaincode: str, function: str, args: tuple[bytes, ...], ttl: float) -> Committed:
        call = Call(chaincode, function, args)
        try:
            return await self._submit(call, ttl)
        except Refusal as refused:
            if refused.name not in _BY_TIME or ttl < TTL:
                raise
        # Refused for its time, so it never will be executed: sign anew by the right clock.
        await self._session.learn_clock()
        return await self._submit(call, ttl)

    async def _submit(self, call: Call, ttl: float) -> Committed:
        self._process.check()
        session = self._session
        context, not_after = session.context, self.now() + scaled("ttl", ttl, 1_000_000)
        own = context.chain[0]
        known = session.known_block()
        transaction = prepare(
            call, network=context.network, certificate=own, key=context.key, not_after=not_after, known_block=known
        )
        if session.in_flight.introduced != own:
            transaction = transaction.introduced(own)
        return await session.in_flight.add(transaction, own, session.deadline)

    async def query(self, chaincode: str, function: str, *args: bytes) -> bytes:
        """Calls a function on the committed state. The answer has everything that any node acknowledged before the call."""
        self._process.check()
        request = api.QueryRequest(chaincode=chaincode, function=function, args=args)

        async def ask(link: Any) -> api.QueryResponse:
            answer: api.QueryResponse = await link.ask(link.query, request, CONNECT_MAX)
            refused = of_verdict(answer.verdict)
            if refused is not None:
                raise refused
            return answer

        answer = await self._session.ask(ask)
        return answer.response

    async def status(self) -> api.StatusResponse:
        """How the node is that it is connected to."""
        self._process.check()
        return await self._session.ask(lambda link: link.ask(link.status, api.StatusRequest(), CONNECT_MAX))

    async def robots(self) -> list[dict[str, Any]]:
        """All robots with their services and who holds them, as `ledgerctl robot list -o json` has them."""
        return await self.pages(ABAC, "robots")

    async def grants(self) -> list[dict[str, Any]]:
        """All grants."""
        return await self.pages(ABAC, "grants")

    async def pages(self, chaincode: str, function: str) -> list[dict[str, Any]]:
        """All elements of a list that comes in pages."""
        found: list[dict[str, Any]] = []
        place: dict[str, str] = {}
        while True:
            page = json.loads(await self.query(chaincode, function, json.dumps(place).encode()))
            found.extend(page["items"])
            if not page.get("next") or not page["items"]:
                return found
            place = {"after": page["next"]}

    def acquire(self, service: str, *, wait: float = 0.0, lease: float | None = None, priority: int | None = None) -> Acquiring:
        """Asks for the right to use a service: `async with` releases it at the end, `await` leaves that to you.

        wait        how long to wait while others hold it, in seconds: in its line if it has one, else until it is free
        lease       how long the grant lasts without renewal, in seconds; the client renews it
        priority    a lower priority than the one that you have
        """
        return Acquiring(self, Asked(service, wait, lease, priority))

    async def release(self, service: str, holder: str | None = None) -> list[dict[str, Any]]:
        """Gives a service back, or leaves its line; an admin of the robot's owner takes it back from `holder`."""
        ended: list[dict[str, Any]] = await self._answer("release", service, holder)
        return ended

    async def stop(self, robot: str, reason: str | None = None, *, timeout: float | None = None) -> dict[str, Any]:
        """Stops a robot, or all with "*": whoever commands it loses it, and nobody gets it until it is resumed.

        Robots are notified at once. It returns when the stop is in force; until then it is signed and sent again. After `timeout`
        seconds it raises `Unreachable` (TIMEOUT): the stop is not in force, repeat it.
        """
        last: list[Refusal] = []

        async def until_in_force() -> dict[str, Any]:
            while True:
                try:
                    done: dict[str, Any] = await self._answer("stop", robot, reason)
                    return done
                except Refusal as refused:
                    if refused.kind is not Kind.UNREACHABLE and refused.name not in _BY_TIME:
                        raise
                    last[:] = [refused]
                await asyncio.sleep(_AGAIN)

        try:
            return await asyncio.wait_for(until_in_force(), timeout)
        except asyncio.TimeoutError:
            found = f"the last answer: {last[0].message} [{last[0].code}]" if last else "no answer"
            message = f"the stop of {robot} is not in force: repeat it"
            raise refusal("TIMEOUT", message, found=found, wanted="its verdict in a block", next="stop it again") from None

    async def resume(self, robot: str, reason: str | None = None) -> dict[str, Any]:
        """Lets a stopped robot be commanded again. Stops of it that have no verdict yet are cancelled."""
        open_stops = [stop for stop in (await self.status()).open_stops if robot == "*" or stop.robot in (robot, "*")]
        calls = [f"{stop.id.hex()}:{stop.not_after}" for stop in open_stops[:_NAMED_MAX]]
        words = [reason or "", *calls] if calls else [reason]
        done: dict[str, Any] = await self._answer("resume", robot, *words)
        return done

    async def _answer(self, function: str, *words: str | None) -> Any:
        done = await self.call(ABAC, function, *(word.encode() for word in words if word is not None))
        return json.loads(done.response)

    async def publish(self, service: str, *messages: object, ttl: float = COMMAND_TTL) -> Published:
        """Publishes on a service where a policy is enough, without a grant."""
        return await self.set(service, 0, self.now(), messages, ttl)

    async def set(self, service: str, epoch: int, seq: int, messages: tuple[object, ...], ttl: float) -> Published:
        """Publishes under a grant of that epoch, with that number for the first message."""
        args = [service.encode(), str(epoch).encode(), str(seq).encode(), *payloads(messages)]
        call, began = Call(ABAC, "set", tuple(args)), time.monotonic()
        try:
            done = await self._submit(call, ttl)
        except Refusal as refused:
            if refused.name not in _BY_TIME:
                raise
            # It never will be executed. Signed again it looks young to the robot: so only while it is not too old for it.
            left = min(ttl, await self._max_age(service)) - (time.monotonic() - began)
            if left <= 0:
                raise
            await self._session.learn_clock()
            done = await self._submit(call, left)
        return Published(done.height, done.time, seq, done.id)

    async def _max_age(self, service: str) -> float:
        """Age beyond which the robot drops messages of a service, in seconds."""
        known = self._max_ages.get(service)
        if known is None:
            told = json.loads(await self.query(ABAC, "service", service.encode()))
            known = self._max_ages[service] = told["max_age_ms"] / 1000
        return known

    async def subscribe(self, *services: str, from_height: int = 0) -> Messages:
        """The messages of services from a height on, without end: each once and none missing, through lost connections and
        changes of the leader. 0 is the next block, 1 is the first. The first `next` raises if you may not read them.
        """
        deliveries = self.deliveries(Wanted(from_height, ABAC, services, ["message"]))
        await deliveries.pin()
        return Messages(deliveries, Senders(self.context))

    async def events(self, *subjects: str, names: Sequence[str] = (), from_height: int = 0) -> Events:
        """The events of robots and services from a height on, without end: each once. docs/events.md lists their names."""
        deliveries = self.deliveries(Wanted(from_height, ABAC, subjects, names))
        await deliveries.pin()
        return Events(deliveries)

    def deliveries(self, wanted: Wanted) -> Deliveries:
        """The stream below `subscribe` and `events`: what each block has for them."""
        self._process.check()
        return Deliveries(self._session, wanted)

    async def close(self) -> None:
        """Ends the connection. Grants that were not released end with their leases."""
        if self._process.is_ours():
            await self._session.close()

    async def __aenter__(self) -> Client:
        return self

    async def __aexit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        await self.close()
