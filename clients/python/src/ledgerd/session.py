"""The one connection of a client, and its replacement by another when it breaks."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import time
from collections.abc import Awaitable, Callable
from typing import Final, TypeVar

import grpc
import grpc.aio

from ledgerd import tls
from ledgerd.codes import Kind
from ledgerd.context import Context
from ledgerd.in_flight import RETRY_AFTER, Effect, InFlight
from ledgerd.link import Link
from ledgerd.refusal import Refusal, refusal
from ledgerd.reaching import Found, Reach
from ledgerd.transaction import KNOWN_HASH_BYTES
from ledgerd.v1 import enrolment_pb2 as enrolment
from ledgerd.v1 import gateway_pb2 as api
from ledgerd.v1 import transaction_pb2 as signed

_LOG: Final = logging.getLogger("ledgerd")

CONNECT_MAX: Final = 3.0
"""How long connecting to one node may take, in seconds."""
_SWEEP_EVERY: Final = 0.1
# Pause between rounds over all nodes: doubles from the first to the second.
_PAUSE_MIN: Final = 0.05
_PAUSE_MAX: Final = 1.0
# A connected client asks so often how its node stands.
_LOOK_EVERY: Final = 15.0
_LOOK_MAX: Final = 5.0
# A block that was just executed is not older than this by the node's clock, microseconds.
_BLOCK_AGE_MAX: Final = 1_000_000
# A question that takes longer than this is asked elsewhere.
_ASK_MAX: Final = 3.0

Answer = TypeVar("Answer")


class Session:
    """Keeps one connection to a node that serves, as long as it is open."""

    def __init__(self, context: Context, deadline: float) -> None:
        self.context = context
        self.deadline = deadline
        self.in_flight = InFlight(several=len(context.addresses()) > 1)
        self.seen = 0
        self.broken: Refusal | None = None
        self._link: Link | None = None
        self._change = asyncio.Condition()
        self._unwanted = asyncio.Event()
        self._requests: asyncio.Queue[api.SubmitRequest] = asyncio.Queue()
        self._avoided: list[str] = []
        # The node's clock less our monotonic one, microseconds.
        self._clock = 0
        self._clock_doubted = False
        # The newest block that the connected node has told of: height, part of its hash, and when (monotonic clock, microseconds).
        self._known: tuple[int, bytes, int] | None = None
        self._tasks: list[asyncio.Task[None]] = []
        self._closed = False

    async def start(self) -> None:
        """Connects, and keeps connected from now on."""
        found = await self._reach().first()
        self._tasks = [asyncio.create_task(self._keep(found)), asyncio.create_task(self._sweep())]

    def _reach(self) -> Reach:
        known = self.context.addresses()
        ordered = [one for one in known if one not in self._avoided] + [one for one in self._avoided if one in known]
        return Reach(self.context, tls.settings_of(self.context), ordered, CONNECT_MAX)

    async def close(self) -> None:
        """Ends the connection. Transactions on their way are executed or not."""
        self._closed = True
        for task in self._tasks:
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)
        reason = refusal("SHUTTING_DOWN", "the client is closed")
        self.in_flight.close(reason)
        link, self._link = self._link, None
        self.broken = reason
        if link is not None:
            await link.close()
        async with self._change:
            self._change.notify_all()

    @property
    def node(self) -> str | None:
        """Address of the node that it is connected to."""
        return self._link.address if self._link else None

    def now(self) -> int:
        """The node's clock now, microseconds since the UNIX epoch: what transactions are dated by."""
        return self._clock + time.monotonic_ns() // 1000

    def see(self, height: int) -> None:
        """Takes note of a height that a node has told."""
        self.seen = max(self.seen, height)

    def knows(self, height: int, block_hash: bytes) -> None:
        """Takes note of a block of which the node tells. The hash may be longer than the part by which it is named, or missing."""
        if len(block_hash) >= KNOWN_HASH_BYTES and (self._known is None or height > self._known[0]):
            self._known = height, block_hash[:KNOWN_HASH_BYTES], time.monotonic_ns() // 1000

    def known_block(self) -> signed.KnownBlock | None:
        """The newest block of which the node has told, as a transaction names it now."""
        if self._known is None:
            return None
        height, block_hash, since = self._known
        return signed.KnownBlock(height=height, hash=block_hash, known_us=time.monotonic_ns() // 1000 - since)

    async def up(self) -> Link:
        """The connection, as soon as there is one. Raises why there will be none if waiting does not cure it."""
        async with self._change:
            await self._change.wait_for(lambda: self._link is not None or self._is_hopeless())
        if self._link is None:
            assert self.broken is not None
            raise self.broken
        return self._link

    def _is_hopeless(self) -> bool:
        return self._closed or (self.broken is not None and self.broken.kind is not Kind.UNREACHABLE)

    def leave(self, link: Link) -> None:
        """Asks for another connection than this one."""
        if link is self._link:
            self._unwanted.set()

    def no_connection(self) -> Refusal:
        """No node answers in time, and why."""
        address = self._link.address if self._link else self.context.addresses()[0]
        return self.broken or tls.unreachable(address, f"no answer within {self.deadline:g} s")

    async def ask(self, question: Callable[[Link], Awaitable[Answer]]) -> Answer:
        """Asks one node after the other until one answers, at most as long as the deadline of the client."""
        until = time.monotonic() + self.deadline
        last: Refusal | None = None
        while (left := until - time.monotonic()) > 0:
            link = None
            try:
                link = await asyncio.wait_for(self.up(), left)
                return await asyncio.wait_for(question(link), min(_ASK_MAX, left))
            except Refusal as refused:
                if refused.kind is not Kind.UNREACHABLE:
                    raise
                last = refused
                own = self.in_flight.several and refused.name in ("NO_LEADER", "BEHIND", "CLOCK_OUT_OF_BOUNDS")
                leave = own or refused.name == "SHUTTING_DOWN"
            except (asyncio.TimeoutError, TimeoutError):
                leave = True
            if link is not None and leave:
                self.leave(link)
            await asyncio.sleep(RETRY_AFTER)
        raise last or self.no_connection()

    async def learn_clock(self) -> None:
        """Asks the node for its clock."""
        asked = time.monotonic_ns() // 1000
        told = await self.ask(lambda link: link.ask(link.network, enrolment.NetworkRequest(), CONNECT_MAX))
        self._set_clock(told.clock, asked)

    def _set_clock(self, clock: int, asked: int) -> None:
        """The node has looked at its clock about in the middle between question and answer."""
        self._clock = clock - (asked + time.monotonic_ns() // 1000) // 2

    async def _keep(self, found: Found) -> None:
        while True:
            await self._install(found)
            self.broken = await self._serve(found.link)
            _LOG.debug("connection lost: %s", self.broken.message)
            if found.link.address in self._avoided:
                self._avoided.remove(found.link.address)
            self._avoided.append(found.link.address)
            self._link = None
            self.in_flight.detach()
            await found.link.close()
            found = await self._reopen()

    async def _reopen(self) -> Found:
        pause = _PAUSE_MIN
        while True:
            await asyncio.sleep(pause)
            pause = min(pause * 2, _PAUSE_MAX)
            try:
                await self._take_renewed()
                return await self._reach().first()
            except Refusal as refused:
                self.broken = refused
                async with self._change:
                    self._change.notify_all()

    async def _take_renewed(self) -> None:
        """Another program may have renewed the certificate that this one uses."""
        context = self.context
        if context.home is None:
            return
        with contextlib.suppress(Refusal):
            stored = await asyncio.to_thread(Context.load, context.name, context.home)
            if stored.network == context.network and stored.id == context.id and stored.chain != context.chain:
                self.context = stored

    def renewed(self, context: Context) -> None:
        """Goes on with a renewed certificate: it signs what comes next, and a new connection shows it."""
        self.context = context
        self._unwanted.set()

    async def _install(self, found: Found) -> None:
        self._set_clock(found.told.clock, found.asked)
        # A node before it may have told of blocks that do not exist.
        self._known = None
        self.knows(found.told.height, found.told.block_hash)
        self._learn(found.told, found.link.address)
        self._unwanted.clear()
        self._requests = asyncio.Queue()
        self._link, self.broken = found.link, None
        self.in_flight.attach(self._requests.put_nowait)
        async with self._change:
            self._change.notify_all()

    def _learn(self, told: enrolment.NetworkResponse, address: str) -> None:
        try:
            learnt = self.context.learn(told, address)
        except Refusal as unusable:
            _LOG.debug("cannot use what %s tells of its network: %s", address, unusable.message)
            return
        if learnt is not self.context:
            self.context = learnt
            self.in_flight.several = len(learnt.addresses()) > 1
            asyncio.get_running_loop().run_in_executor(None, learnt.note)

    async def _serve(self, link: Link) -> Refusal:
        """Carries transactions and verdicts until the connection breaks or is found wanting; says why."""
        call = link.submit_stream()
        parts = [
            asyncio.create_task(self._write(call)),
            asyncio.create_task(self._read(link, call)),
            asyncio.create_task(self._look(link)),
            asyncio.create_task(self._wait_unwanted(link)),
        ]
        try:
            done, _ = await asyncio.wait(parts, return_when=asyncio.FIRST_COMPLETED)
            ends = [None if part.cancelled() else part.exception() for part in done]
        finally:
            call.cancel()
            for part in parts:
                part.cancel()
            await asyncio.gather(*parts, return_exceptions=True)
        end = next((one for one in ends if isinstance(one, Refusal)), None)
        if end is None and any(isinstance(one, grpc.aio.AioRpcError) for one in ends):
            end = link.refusal(next(one for one in ends if isinstance(one, grpc.aio.AioRpcError)))
        return end or link.fault or tls.unreachable(link.address, "the node closed the connection")

    async def _write(self, call: grpc.aio.StreamStreamCall[api.SubmitRequest, api.SubmitResponse]) -> None:
        while True:
            request = await self._requests.get()
            request.min_height = self.seen
            await call.write(request)

    async def _read(self, link: Link, call: grpc.aio.StreamStreamCall[api.SubmitRequest, api.SubmitResponse]) -> None:
        async for answer in call:
            self.see(answer.height)
            self.knows(answer.height, answer.block_hash)
            if answer.height > 0 and self.now() > answer.time + _BLOCK_AGE_MAX:
                self._clock_doubted = True
            elif self.now() < answer.time:
                # Another leader's clock is ahead of the one that was told. What is dated by that one would expire too early.
                self._clock = answer.time - time.monotonic_ns() // 1000
            effect = self.in_flight.answer(answer)
            if effect is Effect.LEAVE and self.in_flight.several:
                self.leave(link)
            self._clock_doubted |= effect is Effect.DOUBT_CLOCK

    async def _look(self, link: Link) -> None:
        """Asks the node from time to time how it stands, and leaves one that can have nothing ordered."""
        while True:
            await asyncio.sleep(_LOOK_EVERY)
            with contextlib.suppress(Refusal):
                told = await link.ask(link.network, enrolment.NetworkRequest(), _LOOK_MAX)
                self._learn(told, link.address)
                if told.cut_off and self.in_flight.several:
                    if await self._is_better_elsewhere(link):
                        self.leave(link)

    async def _is_better_elsewhere(self, link: Link) -> bool:
        others = [one for one in self.context.addresses() if one != link.address]
        try:
            found = await Reach(self.context, tls.settings_of(self.context), others, CONNECT_MAX).first()
        except Refusal:
            return False
        await found.link.close()
        return not found.told.cut_off

    async def _wait_unwanted(self, link: Link) -> None:
        await self._unwanted.wait()
        raise tls.unreachable(link.address, "the node could not serve; trying another one")

    async def _sweep(self) -> None:
        while True:
            await asyncio.sleep(_SWEEP_EVERY)
            if self.in_flight.sweep(self.broken) and self._link is not None:
                self.leave(self._link)
            if self._clock_doubted and self._link is not None:
                self._clock_doubted = False
                with contextlib.suppress(Refusal):
                    # Deadlines must not wait long for a node.
                    link = self._link
                    asked = time.monotonic_ns() // 1000
                    told = await link.ask(link.network, enrolment.NetworkRequest(), _SWEEP_EVERY * 5)
                    self._set_clock(told.clock, asked)
