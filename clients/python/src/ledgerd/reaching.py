"""Finding a node that serves: the best first, the next ones soon after it, never all of their patience in a row.

A node that was killed refuses at once; one that was stopped or cut off says nothing. So nobody is waited for longer than
`_STAGGER` before the next one is asked too. A node that answers but can have nothing ordered is taken only if no other one can.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

from cryptography import x509

from ledgerd import certificate, tls
from ledgerd.codes import Kind
from ledgerd.context import Context
from ledgerd.link import Link
from ledgerd.refusal import Refusal, refusal
from ledgerd.tls import Settings
from ledgerd.v1 import enrolment_pb2 as enrolment

_STAGGER: Final = 0.3
# How long better nodes are waited for once one has answered that can have nothing ordered.
_BETTER_WITHIN: Final = 1.0
# Clocks that differ by less, in microseconds, are not what certificates fail by.
_CLOCK_OFF: Final = 5 * 60 * 1_000_000


@dataclass(frozen=True)
class Found:
    """A connection, what its node has told of its network, and when it was asked (monotonic clock, microseconds)."""

    link: Link
    told: enrolment.NetworkResponse
    asked: int


@dataclass(frozen=True)
class Reach:
    """One look for a node among several."""

    context: Context
    settings: Settings
    addresses: Sequence[str]
    patience: float

    async def first(self) -> Found:
        """Connects to the first node that can have something ordered; if there is none, to one that answers."""
        waiting = list(enumerate(self.addresses))
        running: dict[asyncio.Task[Found], int] = {}
        refusals: dict[int, Refusal] = {}
        second: Found | None = None
        settle_at: float | None = None
        next_at = time.monotonic()
        try:
            while waiting or running:
                now = time.monotonic()
                if settle_at is not None and settle_at <= now:
                    break
                if waiting and next_at <= now:
                    number, address = waiting.pop(0)
                    running[asyncio.create_task(self._open(address))] = number
                    next_at = now + _STAGGER
                wakes = [at for at in (next_at if waiting else None, settle_at) if at is not None]
                timeout = max(0.0, min(wakes) - now) if wakes else None
                done, _ = await asyncio.wait(running, timeout=timeout, return_when=asyncio.FIRST_COMPLETED)
                for task in done:
                    number = running.pop(task)
                    error = task.exception()
                    if isinstance(error, Refusal):
                        refusals[number] = error
                    elif error is not None:
                        raise error
                    elif not task.result().told.cut_off:
                        taken = task.result()
                        if second is not None:
                            await second.link.close()
                            second = None
                        return taken
                    elif second is None:
                        second, settle_at = task.result(), time.monotonic() + _BETTER_WITHIN
                    else:
                        await task.result().link.close()
                    next_at = time.monotonic()
        except BaseException:
            if second is not None:
                await second.link.close()
            raise
        finally:
            await _end(running)
        if second is not None:
            return second
        raise _summary([refusals[number] for number in sorted(refusals)])

    async def _open(self, address: str) -> Found:
        try:
            link = await Link.open(address, self.settings, self.patience)
        except Refusal as refused:
            raise await self._explained(refused, address) from refused
        try:
            asked = time.monotonic_ns() // 1000
            told = await link.ask(link.network, enrolment.NetworkRequest(), self.patience)
            if told.network != self.context.network:
                raise _other_network(address, self.context, told)
            return Found(link, told, asked)
        except Refusal as refused:
            await link.close()
            raise await self._explained(refused, address) from refused
        except BaseException:
            await link.close()
            raise

    async def _explained(self, refused: Refusal, address: str) -> Refusal:
        """The refusal in better words, if the node can be asked for them. Nothing that it says is believed beyond that."""
        if refused.name not in ("UNTRUSTED", "CERTIFICATE_EXPIRED", "CERTIFICATE_NOT_YET_VALID"):
            return refused
        here = time.time_ns() // 1000
        told = await told_by_anybody(address, self.context.network, self.patience)
        if told is None:
            return certificate.expired(self._own(), self.context.organisation, here) or refused
        if told.network != self.context.network:
            return _other_network(address, self.context, told)
        first, last = certificate.validity(self._own())
        is_valid_here, is_valid_there = first <= here <= last, first <= told.clock <= last
        if abs(here - told.clock) > _CLOCK_OFF and (is_valid_here != is_valid_there or refused.name != "UNTRUSTED"):
            return clocks_differ(address, here, told.clock)
        return certificate.expired(self._own(), self.context.organisation, told.clock) or refused

    def _own(self) -> x509.Certificate:
        return certificate.parse(self.context.chain[0])


async def told_by_anybody(address: str, network: bytes | None, patience: float) -> enrolment.NetworkResponse | None:
    """What a node says of its network and its clock, without showing or believing anything."""
    try:
        link = await Link.open(address, tls.settings_unverified(network), patience)
    except Refusal:
        return None
    try:
        return await link.ask(link.network, enrolment.NetworkRequest(), patience)
    except Refusal:
        return None
    finally:
        await link.close()


def clocks_differ(address: str, here: int, there: int) -> Refusal:
    """The clocks of this machine and of a node differ so much that good certificates look expired."""
    seconds, way = abs(here - there) // 1_000_000, "ahead of" if here > there else "behind"
    shown = [f"{certificate.moment(at):%Y-%m-%dT%H:%M:%SZ}" for at in (here, there)]
    return refusal(
        "CLOCK_OFF",
        f"the clock of this machine is {seconds} s {way} that of the node at {address}",
        found=f"{shown[0]} here, {shown[1]} there",
        wanted="clocks that agree: certificates are valid from one moment to another",
        next="set the clock of this machine: timedatectl set-ntp true; if it is right, inform the node's operator",
    )


def _other_network(address: str, context: Context, told: enrolment.NetworkResponse) -> Refusal:
    found = f'network {told.network.hex()} "{told.label}"'
    wanted = f"network {context.network.hex()}, as in the context"
    if any(one.name == context.organisation for one in told.organisations):
        advice = f"ask an admin of {context.organisation} in that network to register you, then enrol again with force"
    else:
        advice = "check the address, or select the context of that network"
    message = f"a different network answers at {address}"
    return refusal("WRONG_NETWORK", message, found=found, wanted=wanted, next=advice)


async def _end(running: dict[asyncio.Task[Found], int]) -> None:
    for task in running:
        task.cancel()
    for outcome in await asyncio.gather(*running, return_exceptions=True):
        if isinstance(outcome, Found):
            await outcome.link.close()


def _summary(refusals: list[Refusal]) -> Refusal:
    """One refusal for those of all nodes: final only if each of them is."""
    if not refusals:
        advice = "add one to `nodes` in context.toml"
        return refusal("BAD_ARGUMENT", "there is no node to connect to", wanted="an address, HOST:PORT", next=advice)
    first = refusals[0]
    if len(refusals) == 1 or all(one.kind is not Kind.UNREACHABLE for one in refusals):
        return first
    found = "; ".join(f"{one.message} ({one.found})" for one in refusals)
    message = f"none of {len(refusals)} nodes can be reached"
    return refusal("UNREACHABLE", message, found=found, wanted=first.wanted, next=first.next)
