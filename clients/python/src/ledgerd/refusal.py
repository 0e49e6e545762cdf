"""Refusals as exceptions: the four lines that `ledgerctl` prints, with the same code."""

from __future__ import annotations

from typing import Final

from google.protobuf.message import DecodeError
from google.rpc import error_details_pb2, status_pb2

from ledgerd.codes import CODES, Kind
from ledgerd.v1 import gateway_pb2 as api

DOMAIN: Final = "ledgerd"
"""The domain of the `google.rpc.ErrorInfo` of every refusal of a node."""

_NUMBERS: Final = {name: number for number, (name, _) in CODES.items()}
_INTERNAL: Final = 5005
# Column of the code in the first line.
_CODE_COLUMN: Final = 88


class Refusal(Exception):
    """Why something was refused. The subclass says how to react; `str()` is the text that `ledgerctl` prints.

    code    the stable code, such as "LGR-3005"; docs/errors.md explains each
    name    its name, such as "HELD"
    number  its number, such as 3005
    kind    how a program should react
    message the refusal in one line
    found, wanted, next
            what was found, what would have been accepted, and what to try; each may be empty
    """

    def __init__(self, number: int, message: str, *, found: str = "", wanted: str = "", next: str = "") -> None:
        if number not in CODES:
            message = f"{message} (code {number}, unknown to this version)"
            number = _INTERNAL
        super().__init__(number, message)
        self.number = number
        self.name, self.kind = CODES[number]
        self.code = f"LGR-{number:04}"
        self.message = message
        self.found = found
        self.wanted = wanted
        self.next = next

    @property
    def is_final(self) -> bool:
        """Does a refusal before ordering with this code promise that the transaction is never executed?"""
        return self.number < 4000 and self.name != "UNKNOWN_CREATOR"

    def __str__(self) -> str:
        first = f"{'error: ' + self.message:<{_CODE_COLUMN}}  [{self.code}]"
        lines = [("found", self.found), ("wanted", self.wanted), ("try", self.next)]
        return "\n".join([first, *(f"  {label:<6}  {line}" for label, line in lines if line)])

    def __repr__(self) -> str:
        return f"<{type(self).__name__} {self.code} {self.name}: {self.message}>"

    def __reduce__(self) -> tuple[object, ...]:
        texts = (self.found, self.wanted, self.next)
        return _rebuilt, (self.number, self.message, *texts)


class Denied(Refusal):
    """The caller may not do this."""


class Invalid(Refusal):
    """The input is wrong; the same again cannot succeed."""


class Expired(Invalid):
    """It came too late to be executed, and never will be: a command to a robot is worth nothing later. Send the next one."""


class Unreachable(Refusal):
    """Nobody answered, or no majority could be reached; the same again may succeed."""


class Conflict(Refusal):
    """Somebody else holds what was asked for, or the robot is stopped."""


class Failure(Refusal):
    """It failed for a reason that is neither the input nor the rights of the caller."""


_OWN_CLASS: Final[dict[str, type[Refusal]]] = {"EXPIRED": Expired}
_KINDS: Final[dict[Kind, type[Refusal]]] = {
    Kind.OK: Failure,
    Kind.FAILURE: Failure,
    Kind.DENIED: Denied,
    Kind.INVALID: Invalid,
    Kind.UNREACHABLE: Unreachable,
    Kind.CONFLICT: Conflict,
}


def refusal(name: str, message: str, *, found: str = "", wanted: str = "", next: str = "") -> Refusal:
    """A refusal by the name of its code, as the subclass of its kind."""
    return numbered(_NUMBERS[name], message, found=found, wanted=wanted, next=next)


def numbered(number: int, message: str, *, found: str = "", wanted: str = "", next: str = "") -> Refusal:
    """A refusal by the number of its code, as the subclass of its kind."""
    name, kind = CODES.get(number, CODES[_INTERNAL])
    return _OWN_CLASS.get(name, _KINDS[kind])(number, message, found=found, wanted=wanted, next=next)


def _rebuilt(number: int, message: str, found: str, wanted: str, next: str) -> Refusal:
    return numbered(number, message, found=found, wanted=wanted, next=next)


def of_verdict(verdict: api.Verdict) -> Refusal | None:
    """The refusal in a verdict; None if the call was executed."""
    if verdict.code == 0:
        return None
    texts = {"found": verdict.found, "wanted": verdict.wanted, "next": verdict.next}
    return numbered(verdict.code, verdict.message, **texts)


def of_status(address: str, code: str, text: str, details: bytes | None) -> Refusal:
    """The refusal in the status of a failed gRPC call to the node at `address`. `details` are the bytes of
    `grpc-status-details-bin`, if they came.
    """
    told = _detailed(text, details) if details else None
    if told is not None:
        return told
    name, advice = _BY_GRPC.get(code, ("INTERNAL", "check the log of the node"))
    return refusal(name, f"the call to {address} failed", found=f"{code}: {text}", next=advice)


def _detailed(text: str, details: bytes) -> Refusal | None:
    status, info = status_pb2.Status(), error_details_pb2.ErrorInfo()
    try:
        status.ParseFromString(details)
        found = any(detail.Unpack(info) and info.domain == DOMAIN for detail in status.details)
    except DecodeError:
        return None
    number = info.metadata.get("code", "").removeprefix("LGR-")
    if not found or not number.isdecimal():
        return None
    # The first line without the code, which the details tell as well.
    first = next(iter(text.splitlines()), "").rpartition(" [LGR-")
    texts = {name: info.metadata.get(key, "") for name, key in (("found", "found"), ("wanted", "wanted"), ("next", "try"))}
    return numbered(int(number), first[0] or first[2], **texts)


_ELSEWHERE: Final = "try again, or use another node"
_BY_GRPC: Final = {
    "UNAVAILABLE": ("UNREACHABLE", _ELSEWHERE),
    "UNKNOWN": ("UNREACHABLE", _ELSEWHERE),
    "CANCELLED": ("UNREACHABLE", _ELSEWHERE),
    "ABORTED": ("UNREACHABLE", _ELSEWHERE),
    # A node tells its own faults with details. Without them it is gRPC whose stream broke, as when a node was killed.
    "INTERNAL": ("UNREACHABLE", _ELSEWHERE),
    "DATA_LOSS": ("UNREACHABLE", _ELSEWHERE),
    "DEADLINE_EXCEEDED": ("TIMEOUT", _ELSEWHERE),
    "UNAUTHENTICATED": ("CERTIFICATE_REQUIRED", "enrol first: ledgerctl enroll"),
    "PERMISSION_DENIED": ("UNTRUSTED", "ask an admin of your organisation"),
    "NOT_FOUND": ("NOT_FOUND", "check the arguments"),
    "RESOURCE_EXHAUSTED": ("OVERLOADED", "send less, or wait"),
    "OUT_OF_RANGE": ("TOO_LARGE", "split it into several calls"),
    "INVALID_ARGUMENT": ("MALFORMED", "check the arguments"),
    "UNIMPLEMENTED": ("INTERNAL", "upgrade the node: it does not support this call"),
}
