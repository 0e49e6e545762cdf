"""Subscriptions that resume where they were cut off."""

from __future__ import annotations

import asyncio
import time
from collections import deque
from collections.abc import AsyncIterator, Sequence
from dataclasses import dataclass
from typing import Final

import grpc.aio

from ledgerd.codes import Kind
from ledgerd.in_flight import RETRY_AFTER
from ledgerd.link import Link
from ledgerd.refusal import Refusal
from ledgerd.senders import ABAC, Message, Senders
from ledgerd.session import CONNECT_MAX, Session
from ledgerd.tls import unreachable
from ledgerd.v1 import gateway_pb2 as api

_HEARTBEAT_MS: Final = 1_000
# A silence of three heartbeats counts as a broken connection.
_SILENCE_MAX: Final = 3.0
# How long a node may take to say anything at all.
_ACCEPT_MAX: Final = 5.0
# A block may carry a time this much before the moment at which it was ordered: clocks differ, and the order takes its time.
_EARLIER_MAX_US: Final = 2_000_000


@dataclass(frozen=True)
class Wanted:
    """Which events are wanted: from which height on (0 is the next block), of which chaincode, about which subjects, and of
    which names. Empty is all that the caller may read.
    """

    from_height: int = 0
    chaincode: str = ABAC
    subjects: Sequence[str] = ()
    names: Sequence[str] = ()


class Deliveries:
    """A stream of deliveries in block order, each block once, through as many connections as it takes. If a node has told of
    blocks that do not exist, what it delivered may come again through another one.
    """

    def __init__(self, session: Session, wanted: Wanted) -> None:
        self._session = session
        self._wanted = wanted
        self._next_height = wanted.from_height
        # The node that told the newest height, and where the stream was before it told any: at a height, or at a moment.
        self._told: tuple[str, int | float] | None = None
        self._open: tuple[Link, grpc.aio.UnaryStreamCall[api.SubscribeRequest, api.Delivery]] | None = None
        self._is_accepted = False

    @property
    def next_height(self) -> int:
        """The height from which it would be resumed: one after the last delivery."""
        return self._next_height

    async def pin(self) -> None:
        """Decides which block the next one is: were it left to the first connection, a message could be missed before it."""
        if self._next_height == 0:
            begun = time.monotonic()
            address, height = await self._session.ask(_height)
            self._next_height, self._told = height + 1, (address, begun)

    async def next(self) -> api.Delivery:
        """The next delivery with events, or a sign of life without any."""
        while True:
            try:
                link, call = await self._subscribed()
                patience = _SILENCE_MAX if self._is_accepted else _ACCEPT_MAX
                delivery = await link.settled(call.read(), patience)
            except Refusal as refused:
                if refused.kind is not Kind.UNREACHABLE:
                    raise
                await self._again(None)
                continue
            except grpc.aio.AioRpcError as error:
                ended = link.refusal(error)
                self._drop()
                if ended.kind is not Kind.UNREACHABLE:
                    raise ended from error
                await self._again(link if ended.name == "SHUTTING_DOWN" else None)
                continue
            except TimeoutError:
                await self._again(link)
                continue
            except BaseException:
                # Whoever gave up waiting may ask again: the stream goes on from where it was.
                self._drop()
                raise
            if not isinstance(delivery, api.Delivery):
                # The node ended the stream: its reader was too slow, or it stops.
                await self._again(None)
                continue
            self._is_accepted = True
            if delivery.early:
                continue
            if await self._is_doubtful(link, delivery):
                self._drop()
                continue
            if self._accept(delivery, link.address):
                return delivery

    async def _again(self, leave: Link | None) -> None:
        self._drop()
        if leave is not None:
            self._session.leave(leave)
        await asyncio.sleep(RETRY_AFTER)

    def _drop(self) -> None:
        if self._open is not None:
            self._open[1].cancel()
        self._open = None

    async def close(self) -> None:
        """Ends the subscription."""
        self._drop()

    async def _subscribed(self) -> tuple[Link, grpc.aio.UnaryStreamCall[api.SubscribeRequest, api.Delivery]]:
        if self._open is not None:
            return self._open
        await self.pin()
        link = await self._session.up()
        request = api.SubscribeRequest(
            from_height=self._next_height,
            chaincode=self._wanted.chaincode,
            subjects=self._wanted.subjects,
            names=self._wanted.names,
            heartbeat_ms=_HEARTBEAT_MS,
        )
        try:
            call = link.subscribe(request)
        except grpc.aio.UsageError as error:
            raise unreachable(link.address, "the connection is closed") from error
        self._open, self._is_accepted = (link, call), False
        return self._open

    async def _is_doubtful(self, link: Link, delivery: api.Delivery) -> bool:
        """Did another node tell of a block above the newest one that is committed? Then the stream goes on from where it was
        before that node: rather twice than not at all. Seldom: a node that follows has soon what another one has told.
        """
        if self._told is None or self._told[0] == link.address or delivery.height + 1 >= self._next_height:
            return False
        # Any function will do: a refusal tells the height as well.
        question = api.QueryRequest(chaincode="msp", function="rules")
        try:
            committed = (await link.ask(link.query, question, CONNECT_MAX)).height
        except Refusal:
            return False
        if committed + 1 >= self._next_height:
            return False
        before = self._told[1]
        try:
            next_height = await _first_since(link, before, committed) if isinstance(before, float) else before
        except Refusal:
            return False
        self._next_height, self._told = next_height, None
        return True

    def _accept(self, delivery: api.Delivery, node: str) -> bool:
        """Notes a delivery of a node; false if its block was delivered before."""
        self._session.see(delivery.height)
        is_repeated = delivery.height < self._next_height and bool(delivery.events)
        if delivery.height + 1 > self._next_height:
            if self._told is None or self._told[0] != node:
                self._told = (node, self._next_height)
            self._next_height = delivery.height + 1
        return not is_repeated


async def _height(link: Link) -> tuple[str, int]:
    return link.address, (await link.ask(link.status, api.StatusRequest(), CONNECT_MAX)).height


async def _first_since(link: Link, moment: float, committed: int) -> int:
    """The first block that was ordered after a moment, or a little before it. By the clock of the node and by block time, so that
    nothing depends on what another node has said.
    """
    status = await link.ask(link.status, api.StatusRequest(), CONNECT_MAX)
    since = status.clock - round((time.monotonic() - moment) * 1_000_000) - _EARLIER_MAX_US
    first, end = max(status.first_height, 1), committed + 1
    while first < end:
        middle = (first + end) // 2
        block = await link.ask(link.get_block, api.GetBlockRequest(height=middle), CONNECT_MAX)
        if block.time < since:
            first = middle + 1
        else:
            end = middle
    return first


@dataclass(frozen=True)
class Event:
    """What a block did: docs/events.md lists names, subjects and payloads."""

    height: int
    time: int
    name: str
    subject: str
    payload: bytes
    chaincode: str = ABAC


class Events(AsyncIterator[Event]):
    """A stream of events, each once, in the order of the ledger."""

    def __init__(self, deliveries: Deliveries) -> None:
        self._deliveries = deliveries
        self._waiting: deque[Event] = deque()

    async def __anext__(self) -> Event:
        while not self._waiting:
            delivery = await self._deliveries.next()
            self._waiting.extend(
                Event(delivery.height, delivery.time, one.name, one.subject, one.payload, one.chaincode)
                for one in delivery.events
            )
        return self._waiting.popleft()

    @property
    def next_height(self) -> int:
        """The height from which another subscription has to begin in order to miss nothing that did not come out here."""
        return self._waiting[0].height if self._waiting else self._deliveries.next_height

    async def aclose(self) -> None:
        """Ends the subscription."""
        await self._deliveries.close()


class Messages(AsyncIterator[Message]):
    """A stream of the messages of services, each once, in the order of the ledger."""

    def __init__(self, deliveries: Deliveries, senders: Senders) -> None:
        self._deliveries = deliveries
        self._senders = senders
        self._waiting: deque[Message] = deque()
        self._events: deque[tuple[api.Delivery, api.EventRecord]] = deque()

    async def __anext__(self) -> Message:
        while not self._waiting:
            while not self._events:
                delivery = await self._deliveries.next()
                self._events.extend((delivery, event) for event in delivery.events)
            # Event by event: after a fault of one the next call goes on with the others.
            self._waiting.extend(self._senders.messages(*self._events.popleft()))
        return self._waiting.popleft()

    @property
    def next_height(self) -> int:
        """The height from which another subscription has to begin in order to miss nothing that did not come out here."""
        if self._waiting:
            return self._waiting[0].height
        return self._events[0][0].height if self._events else self._deliveries.next_height

    async def aclose(self) -> None:
        """Ends the subscription."""
        await self._deliveries.close()
