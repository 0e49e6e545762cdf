"""Certificates: who somebody is, and whether an organisation of the network says so (docs/format.md, "Certificates")."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from datetime import datetime, timezone
from typing import Final

from cryptography import x509
from cryptography.exceptions import InvalidSignature
from cryptography.hazmat.primitives.serialization import Encoding
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID, SignatureAlgorithmOID

from ledgerd.refusal import Refusal, refusal

_ROLES: Final = {
    "member": "member",
    "client": "member",
    "admin": "admin",
    "robot": "robot",
    "node": "node",
    "peer": "node",
    "orderer": "node",
}
_PURPOSES: Final = {ExtendedKeyUsageOID.CLIENT_AUTH, ExtendedKeyUsageOID.ANY_EXTENDED_KEY_USAGE}
_AUTHORITIES_SIGN_WITH: Final = {
    SignatureAlgorithmOID.ED25519,
    SignatureAlgorithmOID.ECDSA_WITH_SHA256,
    SignatureAlgorithmOID.ECDSA_WITH_SHA384,
}
_BYTES_MAX: Final = 16 * 1024
_UNLIMITED: Final = frozenset((x509.BasicConstraints, x509.KeyUsage, x509.ExtendedKeyUsage))


@dataclass(frozen=True)
class Organisation:
    """A member of the network with its authorities, in DER."""

    name: str
    roots: tuple[bytes, ...]
    intermediates: tuple[bytes, ...] = field(default=())


def parse(der: bytes) -> x509.Certificate:
    """Reads a certificate."""
    if len(der) > _BYTES_MAX:
        raise refusal("CERTIFICATE_MALFORMED", "a certificate is too large", found=f"{len(der)} bytes", wanted=f"at most {_BYTES_MAX}")
    try:
        return x509.load_der_x509_certificate(der)
    except ValueError as error:
        raise refusal("CERTIFICATE_MALFORMED", "bytes are no X.509 certificate", found=str(error)) from error


def common_name(certificate: x509.Certificate) -> str:
    """The name of an identity."""
    names = [str(value.value) for value in certificate.subject.get_attributes_for_oid(NameOID.COMMON_NAME)]
    if len(names) != 1:
        raise refusal("CERTIFICATE_MALFORMED", "a certificate has exactly one name", found=f"CN {names}")
    return names[0]


def role(certificate: x509.Certificate) -> str:
    """The role of an identity: member, admin, node or robot."""
    units = certificate.subject.get_attributes_for_oid(NameOID.ORGANIZATIONAL_UNIT_NAME)
    found = {_ROLES[str(unit.value)] for unit in units if unit.value in _ROLES}
    if len(found) > 1:
        raise refusal("CERTIFICATE_MALFORMED", "a certificate has one role", found=", ".join(sorted(found)))
    return next(iter(found), "member")


def signer(der: bytes, organisations: Iterable[Organisation]) -> tuple[str, x509.Certificate]:
    """The identity `ORGANISATION/NAME` in the certificate of somebody who signs, and the certificate. It was good when its
    life began; whether it still was when the transaction was executed, the ledger has decided.
    """
    certificate = parse(der)
    moment = certificate.not_valid_before_utc
    if _is_usable(certificate, moment, None):
        for organisation in organisations:
            roots, others = ([parse(one) for one in ders] for ders in (organisation.roots, organisation.intermediates))
            if _is_issued(certificate, moment, roots, others, 0):
                return f"{organisation.name}/{common_name(certificate)}", certificate
    raise refusal(
        "UNTRUSTED",
        "a certificate is of no organisation that the context knows",
        found=f"{certificate.subject.rfc4514_string()}, issued by {certificate.issuer.rfc4514_string()}",
        wanted="a certificate below a root of one of: " + ", ".join(one.name for one in organisations),
        next="update the organisations of the context, then try again: ledgerctl context refresh",
    )


def check_own(der: bytes, chain: Sequence[bytes], organisation: Organisation, moment: datetime) -> x509.Certificate:
    """Checks a certificate that a CA has just made for us, against the authorities of one organisation alone."""
    certificate = parse(der)
    roots = [parse(one) for one in organisation.roots]
    others = [parse(one) for one in (*organisation.intermediates, *chain)]
    if _is_usable(certificate, moment, None) and _is_issued(certificate, moment, roots, others, 0):
        return certificate
    raise refusal(
        "UNTRUSTED",
        f"a certificate is not of {organisation.name}",
        found=f"{certificate.subject.rfc4514_string()}, issued by {certificate.issuer.rfc4514_string()}",
        wanted=f"a certificate below a root of {organisation.name} that is valid now",
        next="enrol at another node of the organisation, and inform its admin",
    )


def _is_usable(certificate: x509.Certificate, moment: datetime, below: int | None) -> bool:
    """May it be used at this moment by a signer, or by an authority with so many authorities below it?"""
    try:
        extensions = {type(one.value): one for one in certificate.extensions}
    except (ValueError, x509.DuplicateExtension):
        return False
    strange = any(one.critical and kind not in _UNLIMITED for kind, one in extensions.items())
    if certificate.version != x509.Version.v3 or strange or x509.NameConstraints in extensions:
        return False
    if not certificate.not_valid_before_utc <= moment <= certificate.not_valid_after_utc:
        return False
    values = {kind: one.value for kind, one in extensions.items()}
    basic, usage, purposes = (values.get(kind) for kind in (x509.BasicConstraints, x509.KeyUsage, x509.ExtendedKeyUsage))
    if isinstance(purposes, x509.ExtendedKeyUsage) and _PURPOSES.isdisjoint(purposes):
        return False
    is_authority = isinstance(basic, x509.BasicConstraints) and basic.ca
    if below is None:
        return not is_authority and (not isinstance(usage, x509.KeyUsage) or usage.digital_signature)
    if not isinstance(basic, x509.BasicConstraints) or not basic.ca:
        return False
    short = basic.path_length is None or below <= basic.path_length
    return short and (not isinstance(usage, x509.KeyUsage) or usage.key_cert_sign)


def _is_issued(
    certificate: x509.Certificate,
    moment: datetime,
    roots: Sequence[x509.Certificate],
    others: Sequence[x509.Certificate],
    below: int,
) -> bool:
    """Does a path lead over other authorities of the organisation to one of its roots?"""
    if certificate.signature_algorithm_oid not in _AUTHORITIES_SIGN_WITH:
        return False
    for issuer in (*roots, *others):
        try:
            certificate.verify_directly_issued_by(issuer)
        except (InvalidSignature, TypeError, ValueError):
            continue
        further = [other for other in others if other != issuer]
        if _is_usable(issuer, moment, below) and (issuer in roots or _is_issued(issuer, moment, roots, further, below + 1)):
            return True
    return False


def validity(certificate: x509.Certificate) -> tuple[int, int]:
    """First and last moment at which it is valid, microseconds since the UNIX epoch. It is valid to the end of its last second."""
    first, last = certificate.not_valid_before_utc, certificate.not_valid_after_utc
    return int(first.timestamp()) * 1_000_000, int(last.timestamp()) * 1_000_000 + 999_999


def moment(micros: int) -> datetime:
    """A time in microseconds since the UNIX epoch, to the second."""
    return datetime.fromtimestamp(micros // 1_000_000, timezone.utc)


def pem(ders: Iterable[bytes]) -> str:
    """Certificates as PEM text."""
    return "".join(parse(der).public_bytes(Encoding.PEM).decode() for der in ders)


def ders(pem_text: str) -> tuple[bytes, ...]:
    """The certificates of a PEM text, in DER; raises ValueError."""
    return tuple(one.public_bytes(Encoding.DER) for one in x509.load_pem_x509_certificates(pem_text.encode()))


def fingerprint(der: bytes) -> str:
    """SHA-256 of a certificate, in hexadecimal digits."""
    return hashlib.sha256(der).hexdigest()


def expired(certificate: x509.Certificate, organisation: str, now: int) -> Refusal | None:
    """The refusal of an own certificate that is past its validity, or not valid yet; None if it is good."""
    first, last = validity(certificate)
    name = common_name(certificate)
    if now > last:
        again = f"ledgerctl identity register {name} --reissue; then enrol with what it prints, with force"
        return refusal(
            "CERTIFICATE_EXPIRED",
            f"the certificate of {organisation}/{name} has expired",
            found=f"its end on {moment(last):%Y-%m-%dT%H:%M:%SZ}",
            wanted="a valid certificate; it is renewed when used in the last third of its validity",
            next=f"ask an admin of {organisation} for: {again}",
        )
    if now < first:
        return refusal(
            "CERTIFICATE_NOT_YET_VALID",
            f"the certificate of {organisation}/{name} is not valid yet",
            found=f"its begin on {moment(first):%Y-%m-%dT%H:%M:%SZ}",
            wanted="a certificate that is valid now",
            next="check the clock of this machine: timedatectl set-ntp true",
        )
    return None


