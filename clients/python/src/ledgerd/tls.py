"""TLS to nodes, as docs/format.md says: 1.3 only, mutual, the network named in the handshake, and a peer whose role is node.

gRPC for Python can do none of the last three by itself: it checks a host name that the node's certificate does not have, and
tells of a refused certificate only that the connection broke. So this package makes the connection, and gives gRPC the bytes
(see link.py).
"""

from __future__ import annotations

import asyncio
import os
import ssl
import tempfile
from dataclasses import dataclass
from typing import Any, Final

from ledgerd import certificate
from ledgerd.context import Context, is_address, key_pem
from ledgerd.refusal import Refusal, refusal

_ALPN: Final = "h2"
_EXPIRED: Final = 10
_NOT_YET_VALID: Final = 9

# What the alerts of a node say of our certificate: the name of the code, what is wrong, and what to do.
_ALERTS: Final = {
    "CERTIFICATE_EXPIRED": (
        "CERTIFICATE_EXPIRED",
        "has expired, or is not valid yet",
        "enrol again, and check the clocks of both machines",
    ),
    "UNKNOWN_CA": (
        "UNTRUSTED",
        "belongs to no organisation of its network",
        "check that the context is of this node's network",
    ),
    "CERTIFICATE_REVOKED": ("REVOKED", "was revoked", "ask an admin of your organisation"),
    "CERTIFICATE_REQUIRED": ("CERTIFICATE_REQUIRED", "is missing", "enrol first: ledgerctl enroll"),
}
_UNACCEPTED: Final = ("BAD_CERTIFICATE", "CERTIFICATE_UNKNOWN", "UNSUPPORTED_CERTIFICATE", "ACCESS_DENIED")


@dataclass(frozen=True)
class Settings:
    """How connections to the nodes of a network are made: as whom, and whom to believe."""

    context: ssl.SSLContext
    network: bytes | None

    @property
    def server_name(self) -> str:
        """The name that a client sends in a handshake: it says which network it wants."""
        if self.network is None:
            return "node.ledgerd.internal"
        digits = self.network.hex()
        return f"{digits[:32]}.{digits[32:]}.ledgerd.internal"


def settings_of(context: Context) -> Settings:
    """Connections as a stored identity."""
    made = _verified(context.trusted_roots())
    _show(made, certificate.pem(context.chain) + key_pem(context.key))
    return Settings(made, context.network)


def settings_below(root: bytes, network: bytes | None) -> Settings:
    """Connections as nobody, to nodes below one root."""
    return Settings(_verified(certificate.pem([root])), network)


def settings_unverified(network: bytes | None) -> Settings:
    """Connections as nobody to anybody: the answers are good for advice, and for nothing else."""
    return Settings(_bare(), network)


def _bare() -> ssl.SSLContext:
    made = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    made.minimum_version = ssl.TLSVersion.TLSv1_3
    # Names of hosts do not matter: the path to a root counts, and the role.
    made.check_hostname = False
    made.verify_mode = ssl.CERT_NONE
    made.set_alpn_protocols([_ALPN])
    return made


def _verified(roots: str) -> ssl.SSLContext:
    made = _bare()
    made.verify_mode = ssl.CERT_REQUIRED
    # Whatever is a root of an organisation is an anchor, also if another authority has signed it.
    made.verify_flags |= ssl.VERIFY_X509_PARTIAL_CHAIN
    made.load_verify_locations(cadata=roots)
    return made


def _show(made: ssl.SSLContext, text: str) -> None:
    """Makes the connections show a certificate. The library reads it from a file only; the key is on no disk for that."""
    path = None
    try:
        descriptor, path = _nameless_file()
        with os.fdopen(descriptor, "w") as file:
            file.write(text)
            file.flush()
            made.load_cert_chain(path)
    except ssl.SSLError as error:
        raise refusal("BAD_FILE", "certificate and key cannot be used", found=str(error), next="enrol again") from error
    except OSError as error:
        raise short_of_means(error) from error
    finally:
        if path is not None and not path.startswith("/proc/"):
            os.unlink(path)


def _nameless_file() -> tuple[int, str]:
    if hasattr(os, "memfd_create"):
        descriptor = os.memfd_create("ledgerd", os.MFD_CLOEXEC)
        return descriptor, f"/proc/self/fd/{descriptor}"
    return tempfile.mkstemp(prefix="ledgerd-")


def split(address: str) -> tuple[str, int]:
    """Host and port of an address."""
    if not is_address(address):
        raise refusal(
            "BAD_ARGUMENT",
            "an address of a node cannot be read",
            found=repr(address),
            wanted="HOST:PORT, such as 192.168.1.20:7450 or [::1]:7450",
            next="add the port that `ledgerd` printed when it started",
        )
    host, _, port = address.rpartition(":")
    return host.removeprefix("[").removesuffix("]"), int(port)


async def connect(address: str, settings: Settings, patience: float) -> tuple[asyncio.StreamReader, asyncio.StreamWriter]:
    """Connects within so many seconds to a node, and checks that it is one."""
    host, port = split(address)
    try:
        dialled = asyncio.open_connection(host, port, ssl=settings.context, server_hostname=settings.server_name)
        reader, writer = await asyncio.wait_for(dialled, patience)
    except ssl.SSLCertVerificationError as error:
        raise _not_accepted(address, error) from error
    except ssl.SSLError as error:
        raise alerted(address, error) or unreachable(address, f"no TLS 1.3 connection: {error}") from error
    except (asyncio.TimeoutError, TimeoutError) as error:
        raise unreachable(address, f"no answer within {patience:g} s") from error
    except OSError as error:
        raise unreachable(address, str(error)) from error
    try:
        shown = writer.get_extra_info("ssl_object").getpeercert(True)
        if settings.context.verify_mode == ssl.CERT_REQUIRED:
            _check_role(address, shown or b"")
    except ValueError as error:
        # The node has ended the connection already; its last words are on their way to the reader.
        fault = await asyncio.gather(asyncio.wait_for(reader.read(1), patience), return_exceptions=True)
        writer.close()
        raise ended(address, fault[0] if isinstance(fault[0], BaseException) else None) from error
    except BaseException:
        writer.close()
        raise
    return reader, writer


def _check_role(address: str, der: bytes) -> None:
    """A certificate of a user, who also has one of an organisation, does not make a node."""
    shown = certificate.parse(der)
    found = certificate.role(shown)
    if found != "node":
        raise refusal(
            "WRONG_ROLE",
            f"the node at {address} is not trusted: its certificate is not a node's",
            found=f"{certificate.common_name(shown)} with role {found}",
            wanted="role node",
            next="check the address; if it is right, tell the admin of the network",
        )


def presented(connection: Any) -> list[bytes]:
    """The certificates that the other side has shown, its own first. Nothing of them is verified."""
    public = getattr(connection, "get_unverified_chain", None)
    if public is not None:
        return [bytes(der) for der in public() or ()]
    # Before Python 3.13 only the object behind it has it.
    return [bytes(one.public_bytes(_DER)) for one in connection._sslobj.get_unverified_chain() or ()]


# `_ssl.ENCODING_DER`, which is of no public module.
_DER: Final = 2


def unreachable(address: str, reason: str) -> Refusal:
    """No node at this address, and why."""
    return refusal(
        "UNREACHABLE",
        f"cannot reach a node at {address}",
        found=reason,
        wanted="a running node that accepts connections",
        next=f"check that ledgerd is running there and that no firewall blocks the port: nc -vz {address.replace(':', ' ')}",
    )


def short_of_means(error: OSError) -> Refusal:
    """This machine gives no file or socket for a connection. It may do so later, so the next try is worth it."""
    return refusal(
        "UNREACHABLE",
        "this machine has no room for another connection",
        found=str(error),
        wanted="a few open files, and a temporary directory with free space",
        next="raise the limit of open files (ulimit -n), or free space in the temporary directory",
    )


def alerted(address: str, error: ssl.SSLError) -> Refusal | None:
    """What a node says of our certificate with the alert that ends a connection; None if it was another alert."""
    reason = error.reason or ""
    if reason.endswith("UNRECOGNIZED_NAME"):
        return refusal(
            "WRONG_NETWORK",
            f"the process at {address} does not serve this network",
            found="a process that serves other networks, or several",
            wanted="the network of the context",
            next="check the address, or select the context of a network that it serves",
        )
    for alert, (code, what, advice) in _ALERTS.items():
        if reason.endswith(f"ALERT_{alert}"):
            return _refused(address, code, what, alert, advice)
    for alert in _UNACCEPTED:
        if reason.endswith(f"ALERT_{alert}"):
            advice = "check the node's log for the reason, then enrol again"
            return _refused(address, "UNTRUSTED", "is not accepted", alert, advice)
    return None


def ended(address: str, error: BaseException | None) -> Refusal:
    """Why a connection has ended; None if the other side closed it without a word."""
    if isinstance(error, ssl.SSLError):
        return alerted(address, error) or unreachable(address, str(error))
    return unreachable(address, str(error) if error else "the node closed the connection")


def _refused(address: str, code: str, what: str, alert: str, advice: str) -> Refusal:
    return refusal(
        code,
        f"the node at {address} rejects the connection: our certificate {what}",
        found=f"TLS alert {alert}",
        wanted="a valid certificate of an organisation of the network",
        next=advice,
    )


def _not_accepted(address: str, error: ssl.SSLCertVerificationError) -> Refusal:
    first = f"the node at {address} is not trusted"
    if error.verify_code == _EXPIRED:
        advice = "check the clock of this machine; if it is right, inform the node's operator"
        return refusal("CERTIFICATE_EXPIRED", f"{first}: its certificate has expired", found=error.verify_message, next=advice)
    if error.verify_code == _NOT_YET_VALID:
        advice = "check the clock of this machine: timedatectl set-ntp true"
        message = f"{first}: its certificate is not valid yet"
        return refusal("CERTIFICATE_NOT_YET_VALID", message, found=error.verify_message, next=advice)
    return refusal(
        "UNTRUSTED",
        f"{first}: no organisation that the context knows has issued its certificate",
        found=error.verify_message,
        wanted="a certificate below a root of the network",
        next="check the address, or learn the organisations of the network: ledgerctl context refresh",
    )

