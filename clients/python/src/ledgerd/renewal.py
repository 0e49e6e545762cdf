"""Renewal: the next certificate before the present one runs out, proved by the present one. No two programs do it at once."""

from __future__ import annotations

import asyncio
import contextlib
import fcntl
import logging
import os
import time
from collections.abc import Iterator
from typing import Final

from cryptography.hazmat.primitives.asymmetric import ed25519

from ledgerd import certificate, files, tls
from ledgerd.context import Context
from ledgerd.enrolling import DOORS_MAX, is_of_key, new_key, signing_request
from ledgerd.link import Link
from ledgerd.refusal import Refusal, of_verdict, refusal
from ledgerd.session import CONNECT_MAX, Session
from ledgerd.v1 import enrolment_pb2 as enrolment

_LOG: Final = logging.getLogger("ledgerd")
# A renewal that failed is not tried at every start, in seconds.
_RETRY_AFTER: Final = 600
_REASON_BYTES_MAX: Final = 4096
_CUT_SHORT: Final = "the program that tried it last ended before it was done"


async def renew_if_due(session: Session) -> None:
    """Renews the certificate of a stored context in the last third of its life. A failure is logged: the present certificate
    stays in use, and the next try is minutes away.
    """
    context = session.context
    first, last = certificate.validity(certificate.parse(context.chain[0]))
    if context.renew != "auto" or context.home is None or session.now() < last - (last - first) // 3:
        return
    try:
        with _turn(context) as file:
            if file is None:
                return
            stored = await asyncio.to_thread(Context.load, context.name, context.home)
            if stored.chain != context.chain:
                session.renewed(stored)
                return
            if _failed_lately(file):
                return
            _note(file, _CUT_SHORT)
            try:
                session.renewed(await _ask(session, stored))
            except Refusal as refused:
                _note(file, refused.message)
                raise
            _note(file, "")
    except Refusal as refused:
        _LOG.warning("the certificate of %s is not renewed: %s", context.id, refused.message)


async def _ask(session: Session, stored: Context) -> Context:
    own = certificate.parse(stored.chain[0])
    key = new_key("ed25519" if isinstance(stored.key, ed25519.Ed25519PrivateKey) else "p256")
    request = enrolment.RenewRequest(request=signing_request(certificate.common_name(own), key))
    answer = await session.ask(lambda link: link.ask(link.renew, request, CONNECT_MAX))
    for carrier in list(answer.carriers)[:DOORS_MAX]:
        with contextlib.suppress(Refusal):
            answer = await _ask_carrier(carrier, stored, request)
            break
    refused = of_verdict(answer.verdict)
    if refused is not None:
        raise refused
    known = {one.name: one for one in (*stored.organisations, *stored.known.organisations)}
    now = certificate.moment(session.now())
    made = certificate.check_own(answer.certificate, stored.chain[1:], known[stored.organisation], now)
    if not is_of_key(made, key) or (made.subject, made.issuer) != (own.subject, own.issuer):
        raise refusal(
            "UNTRUSTED",
            "the certificate does not match the request",
            found=made.subject.rfc4514_string(),
            wanted=f"a certificate of {own.subject.rfc4514_string()} with our new key",
            next="inform the admin of the organisation; the current certificate stays in use",
        )
    return await asyncio.to_thread(stored.certified, (answer.certificate, *stored.chain[1:]), key)


async def _ask_carrier(address: str, stored: Context, request: enrolment.RenewRequest) -> enrolment.EnrolResponse:
    """Asks a node that carries the CA, where the connected one does not."""
    link = await Link.open(address, tls.settings_of(stored), CONNECT_MAX)
    try:
        return await link.ask(link.renew, request, CONNECT_MAX)
    finally:
        await link.close()


@contextlib.contextmanager
def _turn(context: Context) -> Iterator[int | None]:
    """The right to renew a context; None if somebody else has it. The system takes it back with the process."""
    assert context.home is not None
    path = context.home / files.CONTEXTS / f".{context.name}.renewing"
    try:
        descriptor = os.open(path, os.O_CREAT | os.O_RDWR | os.O_CLOEXEC, 0o600)
    except OSError as error:
        raise files.unwritable(path, error) from error
    try:
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            yield None
            return
        yield descriptor
    finally:
        os.close(descriptor)


def _failed_lately(file: int) -> bool:
    """The file has the reason of a try that failed, and is empty after one that succeeded."""
    age = time.time() - os.fstat(file).st_mtime
    return age < _RETRY_AFTER and bool(os.pread(file, _REASON_BYTES_MAX, 0))


def _note(file: int, reason: str) -> None:
    with contextlib.suppress(OSError):
        os.ftruncate(file, 0)
        os.pwrite(file, reason.encode()[:_REASON_BYTES_MAX], 0)
