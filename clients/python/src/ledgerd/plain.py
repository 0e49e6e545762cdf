"""The client for programs without asyncio. Each call waits for its answer; threads may share a client."""

from __future__ import annotations

import contextlib
from collections.abc import Coroutine, Iterator, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any, Generic, Protocol, TypeVar

from ledgerd import aio, enrolling, grant
from ledgerd.context import Context, Rule
from ledgerd.enrolling import Invitation, KeyKind
from ledgerd.events import Event
from ledgerd.grant import COMMAND_TTL, Published
from ledgerd.in_flight import Committed
from ledgerd.portal import portal
from ledgerd.process import Process
from ledgerd.refusal import Refusal
from ledgerd.senders import Message
from ledgerd.v1 import gateway_pb2 as api

Result = TypeVar("Result")
Element = TypeVar("Element")
Produced = TypeVar("Produced", covariant=True)


def enrol(
    name: str,
    *,
    node: str,
    ca_fingerprint: str,
    secret: str,
    context: str | None = None,
    key: KeyKind | None = None,
    renew: Rule = "auto",
    force: bool = False,
    home: Path | None = None,
) -> Context:
    """Gets a certificate with the one-time secret that `ledgerctl identity register` printed, and stores it as a context, as
    `ledgerctl enroll` does. If it breaks off, call it again: for 15 minutes the same secret gives the same certificate.
    """
    invitation = Invitation(name, node, ca_fingerprint, secret)
    made = enrolling.enrol(invitation, context=context, key=key, renew=renew, force=force, home=home)
    return portal().run(made)


def connect(context: Context | str | None = None, *, home: Path | None = None, deadline: float = aio.DEADLINE) -> Client:
    """Connects as a stored identity, to whichever node of its network serves; without a name as the selected one. A call is
    tried for `deadline` seconds.
    """
    return Client(portal().run(aio.connect(context, home=home, deadline=deadline)))


class Client:
    """A connection to a network as one identity. Use it in a `with`, or close it."""

    def __init__(self, client: aio.Client) -> None:
        self._client = client
        self._process = Process()

    def _run(self, work: Coroutine[Any, Any, Result]) -> Result:
        if not self._process.is_ours():
            work.close()
        self._process.check()
        return portal().run(work)

    @property
    def context(self) -> Context:
        """The identity, and what is known of the network by now."""
        return self._client.context

    @property
    def node(self) -> str | None:
        """Address of the node that it is connected to."""
        return self._client.node

    def call(
        self,
        chaincode: str,
        function: str,
        *args: bytes,
        ttl: float = aio.TTL,
        certified: float = aio.CERTIFIED_WITHIN,
    ) -> Committed:
        """Signs a call, submits it and waits for its verdict; raises that if it is a refusal, and `Unreachable` (TIMEOUT) if
        the outcome is unknown. It is executed once, through however many nodes it goes. Then it waits at most `certified` seconds
        until the outcome is certified, where the network certifies.
        """
        return self._run(self._client.call(chaincode, function, *args, ttl=ttl, certified=certified))

    def certified(self, id: bytes, within: float = aio.CERTIFIED_WITHIN) -> bool:
        """Waits at most so many seconds until a transaction is certified, as the node says. Is it?"""
        return self._run(self._client.certified(id, within))

    def query(self, chaincode: str, function: str, *args: bytes) -> bytes:
        """Calls a function on the committed state. The answer has everything that any node acknowledged before the call."""
        return self._run(self._client.query(chaincode, function, *args))

    def status(self) -> api.StatusResponse:
        """How the node is that it is connected to."""
        return self._run(self._client.status())

    def robots(self) -> list[dict[str, Any]]:
        """All robots with their services and who holds them."""
        return self._run(self._client.robots())

    def grants(self) -> list[dict[str, Any]]:
        """All grants."""
        return self._run(self._client.grants())

    def acquire(self, service: str, *, wait: float = 0.0, lease: float | None = None, priority: int | None = None) -> Grant:
        """Acquires the right to use a service, and renews it in the background; `with` releases it at the end.

        wait        how long to wait while others hold it, in seconds: in its line if it has one, else until it is free
        lease       how long the grant lasts without renewal, in seconds
        priority    a lower priority than the one that you have
        """
        asked = self._client.acquire(service, wait=wait, lease=lease, priority=priority)
        return Grant(self, self._run(_awaited(asked)))

    def release(self, service: str, holder: str | None = None) -> list[dict[str, Any]]:
        """Gives a service back, or leaves its line; an admin of the robot's owner takes it back from `holder`."""
        return self._run(self._client.release(service, holder))

    def stop(self, robot: str, reason: str | None = None, *, timeout: float | None = None) -> dict[str, Any]:
        """Stops a robot, or all with "*": whoever commands it loses it, and nobody gets it until it is resumed.

        Robots are notified at once. It returns when the stop is in force; until then it is signed and sent again. After `timeout`
        seconds it raises `Unreachable` (TIMEOUT): the stop is not in force, repeat it.
        """
        return self._run(self._client.stop(robot, reason, timeout=timeout))

    def resume(self, robot: str, reason: str | None = None) -> dict[str, Any]:
        """Lets a stopped robot be commanded again. Stops of it that have no verdict yet are cancelled."""
        return self._run(self._client.resume(robot, reason))

    def publish(self, service: str, *messages: object, ttl: float = COMMAND_TTL) -> Published:
        """Publishes on a service where a policy is enough, without a grant."""
        return self._run(self._client.publish(service, *messages, ttl=ttl))

    def subscribe(self, *services: str, from_height: int = 0) -> Stream[Message]:
        """The messages of services from a height on, without end: each once and none missing, through lost connections and
        changes of the leader. 0 is the next block, 1 is the first. The first element raises if you may not read them.
        """
        return Stream(self, self._run(self._client.subscribe(*services, from_height=from_height)))

    def events(self, *subjects: str, names: Sequence[str] = (), from_height: int = 0) -> Stream[Event]:
        """The events of robots and services from a height on, without end: each once. docs/events.md lists their names."""
        return Stream(self, self._run(self._client.events(*subjects, names=names, from_height=from_height)))

    def close(self) -> None:
        """Ends the connection. Grants that were not released end with their leases."""
        if self._process.is_ours():
            self._run(self._client.close())

    def __enter__(self) -> Client:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self.close()


class Grant:
    """The right to use a service, renewed in the background until it is released. See `ledgerd.aio.Grant`."""

    def __init__(self, client: Client, held: grant.Grant) -> None:
        self._client = client
        self._held = held
        self.service = held.service
        self.holder = held.holder
        self.epoch = held.epoch
        self.mode = held.mode
        self.lease = held.lease

    @property
    def lost(self) -> Refusal | None:
        """Why it was lost, or None while it is held."""
        return self._held.lost

    @property
    def expires(self) -> int:
        """When it ends unless renewed or used, as of its last renewal; block time in microseconds."""
        return self._held.expires

    def publish(self, *messages: object, ttl: float = COMMAND_TTL) -> Published:
        """Publishes messages in one transaction: raw CDR, or objects of a message class of rclpy. Raises what refuses them;
        they are not executed later than `ttl` seconds from now. `Expired` means that this time is over: send the next message.
        """
        return self._client._run(self._held.publish(*messages, ttl=ttl))

    def wait_lost(self) -> Refusal | None:
        """Waits until it is lost, and says why; None if it was released."""
        return self._client._run(self._held.wait_lost())

    def release(self) -> None:
        """Gives the service back. If that fails, it ends with its lease; a grant that was lost needs no end."""
        # A child process leaves what its parent holds alone.
        if self._client._process.is_ours():
            self._client._run(self._held.release())

    def __enter__(self) -> Grant:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self.release()


class _Source(Protocol[Produced]):
    @property
    def next_height(self) -> int: ...

    async def __anext__(self) -> Produced: ...

    async def aclose(self) -> None: ...


class Stream(Generic[Element], Iterator[Element]):
    """Elements as they come, without end. `next_height` is where another stream has to begin in order to go on from here."""

    def __init__(self, client: Client, source: _Source[Element]) -> None:
        self._client = client
        self._source = source

    @property
    def next_height(self) -> int:
        """The height from which another subscription has to begin in order to miss nothing that did not come out here."""
        return self._source.next_height

    def __next__(self) -> Element:
        return self._client._run(self._source.__anext__())

    def close(self) -> None:
        """Ends the subscription."""
        if self._client._process.is_ours():
            with contextlib.suppress(Refusal):
                self._client._run(self._source.aclose())

    def __enter__(self) -> Stream[Element]:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self.close()


async def _awaited(asked: grant.Acquiring) -> grant.Grant:
    return await asked
