"""Grants: the right to use a service for a while, renewed in the background and given back at the end."""

from __future__ import annotations

import asyncio
import contextlib
import json
import logging
import time
from collections.abc import Generator, Mapping
from dataclasses import dataclass
from types import TracebackType
from typing import TYPE_CHECKING, Any, Final

from ledgerd.codes import Kind
from ledgerd.events import Deliveries, Wanted
from ledgerd.rclpy_messages import serialize
from ledgerd.refusal import Expired, Refusal, refusal
from ledgerd.senders import ABAC
from ledgerd.spans import scaled

if TYPE_CHECKING:
    from ledgerd.aio import Client

_LOG: Final = logging.getLogger("ledgerd")

COMMAND_TTL: Final = 2.0
"""How long a message may wait to be executed, in seconds: a command to a robot is worth nothing later."""

# A renewal is due when this part of the lease has passed.
_RENEW_AFTER: Final = 1 / 3
_RENEW_AGAIN_AFTER: Final = 0.2
# How long giving back may hold up a program that ends, in seconds.
_RELEASE_MAX: Final = 5.0
_LEFT: Final[Mapping[str, tuple[str, str]]] = {
    "timed_out": ("HELD", "others held it for your whole waiting time"),
    "policy": ("DENIED_BY_POLICY", "its policies no longer permit you to acquire it"),
    "revoked": ("REVOKED", "your certificate is revoked"),
    "expired": ("CERTIFICATE_EXPIRED", "your certificate has expired"),
    "unconfirmed": ("HELD", "not enough confirmations in time"),
    "left": ("HELD", "another command of yours left the queue"),
    "removed": ("HELD", "an admin of its owner removed you from the queue"),
    "robot_removed": ("UNKNOWN_SERVICE", "it was removed"),
    "rule": ("HELD", "its owner changed the rule, which shortened or removed the queue"),
}


@dataclass(frozen=True)
class Published:
    """Where a message stands: its block, block time in microseconds, its first sequence number, and its transaction."""

    height: int
    time: int
    seq: int
    transaction: bytes


@dataclass(frozen=True)
class Asked:
    """The terms of a request: service, longest wait and lease in seconds, priority."""

    service: str
    wait: float = 0.0
    lease: float | None = None
    priority: int | None = None

    def arguments(self) -> tuple[bytes, bytes]:
        """As the chaincode wants it. Without a wait it refuses instead of putting us in line."""
        options: dict[str, int] = {"wait_ms": scaled("wait", self.wait, 1000)}
        if self.lease is not None:
            options["lease_ms"] = scaled("lease", self.lease, 1000)
        if self.priority is not None:
            options["priority"] = self.priority
        return self.service.encode(), json.dumps(options).encode()


class Grant:
    """The right to use a service. It is renewed until it is released.

    service, holder     such as `Turtlebot4/cmd_vel` and `Org1/Salma`
    epoch               the fencing token: grows with every grant of the service
    mode                `exclusive`, `open` or `limited`
    lease               how long it lasts without renewal, in seconds
    lost                why it was lost, or None while it is held
    """

    def __init__(self, client: Client, told: Mapping[str, Any]) -> None:
        self._client = client
        self.service: str = told["service"]
        self.holder: str = told["holder"]
        self.epoch: int = told["epoch"]
        self.mode: str = told["mode"]
        self.lease: float = told["lease_ms"] / 1000
        self.expires: int = told["expires"]
        self.lost: Refusal | None = None
        self._next_seq: int = told["next_seq"]
        self._released = False
        self._keeper = asyncio.create_task(self._keep())

    async def publish(self, *messages: object, ttl: float = COMMAND_TTL) -> Published:
        """Publishes messages in one transaction: raw CDR, or objects of a message class of rclpy. Raises what refuses them;
        they are not executed later than `ttl` seconds from now. `Expired` means that this time is over: send the next message.
        """
        if self.lost is not None:
            raise self.lost
        published = await self._client.set(self.service, self.epoch, self._sequence(len(messages)), messages, ttl)
        return published

    def _sequence(self, count: int) -> int:
        """Numbers count from the time in microseconds, so that a restart goes on."""
        first = max(self._next_seq, self._client.now())
        self._next_seq = first + count
        return first

    async def wait_lost(self) -> Refusal | None:
        """Waits until it is lost, and says why; None if it was released."""
        await asyncio.wait([self._keeper])
        return self.lost

    async def release(self) -> None:
        """Gives the service back. If that fails, it ends with its lease; a grant that was lost needs no end."""
        if self._released:
            return
        self._released = True
        self._keeper.cancel()
        await asyncio.gather(self._keeper, return_exceptions=True)
        if self.lost is not None:
            return
        # Whoever gives up waiting for it gives the robot back all the same.
        ending = asyncio.create_task(self._give_back())
        try:
            await asyncio.shield(ending)
        except asyncio.CancelledError:
            with contextlib.suppress(asyncio.CancelledError):
                await asyncio.shield(ending)
            raise

    async def _give_back(self) -> None:
        try:
            await asyncio.wait_for(self._end(), _RELEASE_MAX)
        except Refusal as refused:
            if refused.name != "NOT_HOLDER":
                _LOG.warning("%s is not given back, and ends with its lease: %s", self.service, refused.message)
        except (asyncio.TimeoutError, TimeoutError):
            _LOG.warning("%s is not given back in time, and ends with its lease", self.service)

    async def _end(self) -> None:
        """Ends this grant, and not a later one of the same identity."""
        grants = json.loads(await self._client.query(ABAC, "grants", self.service.encode()))
        if any(one["holder"] == self.holder and one["epoch"] == self.epoch for one in grants):
            await self._client.call(ABAC, "release", self.service.encode())

    async def _keep(self) -> None:
        pause = self.lease * _RENEW_AFTER
        while True:
            await asyncio.sleep(pause)
            pause = self.lease * _RENEW_AFTER
            try:
                done = await self._client.call(ABAC, "renew", self.service.encode())
                told = json.loads(done.response)
                if told["epoch"] != self.epoch:
                    raise refusal("STALE_EPOCH", f"{self.service} was granted anew", found=f"epoch {told['epoch']}")
                self.expires = told["expires"]
            except Refusal as refused:
                if refused.kind is not Kind.UNREACHABLE and not isinstance(refused, Expired):
                    self.lost = refused
                    _LOG.warning("%s is lost: %s", self.service, refused.message)
                    return
                pause = _RENEW_AGAIN_AFTER

    async def __aenter__(self) -> Grant:
        return self

    async def __aexit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        await self.release()


class Acquiring:
    """A grant that is asked for: `await` it, or use it as `async with`."""

    def __init__(self, client: Client, asked: Asked) -> None:
        self._client = client
        self._asked = asked
        self._grant: Grant | None = None

    def __await__(self) -> Generator[Any, None, Grant]:
        return self._acquire().__await__()

    async def __aenter__(self) -> Grant:
        self._grant = await self._acquire()
        return self._grant

    async def __aexit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        if self._grant is not None:
            await self._grant.release()

    async def _acquire(self) -> Grant:
        # Spans that are no numbers fail here, before anything is sent.
        self._asked.arguments()
        until = time.monotonic() + self._asked.wait
        # It may have got the service, or a place in line, that nobody here has heard of.
        try:
            return Grant(self._client, await self._until_granted(until))
        except asyncio.CancelledError:
            await asyncio.shield(self._leave())
            raise
        except Refusal as refused:
            if refused.name == "TIMEOUT":
                await self._leave()
            raise

    async def _until_granted(self, until: float) -> Mapping[str, Any]:
        while True:
            try:
                done = await self._client.call(ABAC, "acquire", *self._asked.arguments())
            except Refusal as refused:
                if refused.name != "HELD" or time.monotonic() >= until:
                    raise
                await self._until_released(until, refused)
                continue
            told: Mapping[str, Any] = json.loads(done.response)
            place = told.get("queued") or told.get("pending")
            if place is None:
                return told
            return await self._until_turn(place["contender"], place["service"], done.height, until)

    async def _until_released(self, until: float, refused: Refusal) -> None:
        """Waits for the end of a grant of a service without a line. Nobody is promised a turn that way."""
        service = await self._named()
        deliveries = self._client.deliveries(Wanted(await self._height() + 1, ABAC, [service], ["released"]))
        # It may have been released before we listen.
        holders = json.loads(await self._client.query(ABAC, "grants", service.encode()))
        if not holders:
            return
        try:
            while left := max(0.0, until - time.monotonic()):
                delivery = await asyncio.wait_for(deliveries.next(), left)
                if delivery.events:
                    return
        except (asyncio.TimeoutError, TimeoutError):
            pass
        finally:
            await deliveries.close()
        raise refused

    async def _named(self) -> str:
        """The service in full; a robot with one service may be named alone."""
        told: Mapping[str, str] = json.loads(await self._client.query(ABAC, "service", self._asked.service.encode()))
        return told["service"]

    async def _height(self) -> int:
        return (await self._client.status()).height

    async def _until_turn(self, contender: str, service: str, height: int, until: float) -> Mapping[str, Any]:
        """Waits in a place in line, or to be confirmed, that was given at this height."""
        deliveries = self._client.deliveries(Wanted(height + 1, ABAC, [service], ["granted", "left"]))
        try:
            return await asyncio.wait_for(_turn(deliveries, contender, service), self._asked.wait + _RELEASE_MAX)
        except (asyncio.TimeoutError, TimeoutError):
            await self._leave()
            raise _not_yours(service, "timed_out") from None
        finally:
            await deliveries.close()

    async def _leave(self) -> None:
        """Leaves the line, or gives the service back if it has just become ours."""
        with contextlib.suppress(Refusal, asyncio.TimeoutError, TimeoutError):
            await asyncio.wait_for(self._client.call(ABAC, "release", self._asked.service.encode()), _RELEASE_MAX)


async def _turn(deliveries: Deliveries, contender: str, service: str) -> Mapping[str, Any]:
    while True:
        for event in (await deliveries.next()).events:
            told: Mapping[str, Any] = json.loads(event.payload)
            if event.name == "granted" and told["holder"] == contender:
                return told
            if event.name == "left" and told["contender"] == contender:
                raise _not_yours(service, told["reason"])


def _not_yours(service: str, reason: str) -> Refusal:
    code, why = _LEFT.get(reason, ("HELD", "you are no longer in the queue"))
    return refusal(
        code,
        f"{service} is not acquired: {why}",
        found=f"removed from the queue: {reason}",
        wanted=f"a grant of {service}",
        next=f"to see holders and queue: ledgerctl queue {service}",
    )


def payloads(messages: tuple[object, ...]) -> list[bytes]:
    """The messages in CDR; at least one."""
    if not messages:
        raise refusal("BAD_ARGUMENT", "there is no message to publish", wanted="at least one")
    return [serialize(message) for message in messages]
