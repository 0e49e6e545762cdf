"""Enrolment: a one-time secret becomes a certificate, with a key that never leaves this machine.

The key is on the disk before the secret is sent. If something breaks off, the same call goes on with the same key: for some
minutes the same secret then gives the same certificate. `ledgerctl enroll` and this module go on with each other's tries.
"""

from __future__ import annotations

import json
import time
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Final, Literal, TypeAlias

from cryptography import x509
from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.asymmetric import ec, ed25519
from cryptography.hazmat.primitives.serialization import Encoding, PublicFormat
from cryptography.x509.oid import NameOID

from ledgerd import certificate, files, tls
from ledgerd.codes import Kind
from ledgerd.context import Context, Rule, is_address, key_pem, names, of_wire, read_key
from ledgerd.link import Link
from ledgerd.reaching import clocks_differ, told_by_anybody
from ledgerd.refusal import Refusal, of_verdict, refusal
from ledgerd.session import CONNECT_MAX
from ledgerd.transaction import PrivateKey
from ledgerd.v1 import enrolment_pb2 as enrolment

KeyKind: TypeAlias = Literal["ed25519", "p256"]

# Most nodes to which an enrolment is taken, one after another, until one carries the CA.
DOORS_MAX: Final = 8
_SETTINGS: Final = "enrolment.toml"
_CLOCK_OFF: Final = 5 * 60 * 1_000_000


@dataclass(frozen=True)
class Invitation:
    """What `ledgerctl identity register` prints: the registered name, the address of a node, the SHA-256 of the CA's
    certificate, and the one-time secret.
    """

    name: str
    node: str
    ca_fingerprint: str
    secret: str

    def check(self) -> None:
        """Refuses what cannot be an invitation, before anything is made or sent."""
        if not is_address(self.node):
            tls.split(self.node)
        if len(self.ca_fingerprint) != 64 or not set(self.ca_fingerprint.lower()) <= set("0123456789abcdef"):
            raise refusal(
                "BAD_ARGUMENT",
                "the CA's fingerprint cannot be read",
                found=repr(self.ca_fingerprint),
                wanted="SHA-256 of the CA's certificate: 64 hexadecimal digits",
                next="copy the whole command that `ledgerctl identity register` printed",
            )


async def enrol(
    invitation: Invitation,
    *,
    context: str | None = None,
    key: KeyKind | None = None,
    renew: Rule = "auto",
    force: bool = False,
    home: Path | None = None,
) -> Context:
    """Gets a certificate with a one-time secret, and stores it as a context of that name, or the identity's own."""
    invitation.check()
    # The name may be ORGANISATION/NAME; only its last part can be in a certificate.
    own_name = invitation.name.rpartition("/")[2]
    name, place = context or own_name, home or files.home()
    files.check_name(name)
    if not force and name in names(place):
        raise refusal(
            "ALREADY_EXISTS",
            f'the context "{name}" exists already',
            found=f"a key in {place / files.CONTEXTS / name}",
            wanted="an unused name: the key would be lost",
            next="choose another name for the context, or replace it with force",
        )
    directory, private = _begin(place, name, invitation, key)
    answer = await _knock_at_all(invitation, signing_request(own_name, private))
    enrolled = _checked(invitation, own_name, private, answer)
    stored = Context(
        name=name,
        organisation=answer.organisation,
        network=answer.network.network,
        label=answer.network.label,
        nodes=_nodes(invitation.node, answer),
        chain=(answer.certificate, *answer.chain),
        key=private,
        organisations=enrolled,
        renew=renew,
    ).save(place)
    files.remove(directory)
    return stored


def _begin(home: Path, context: str, invitation: Invitation, kind: KeyKind | None) -> tuple[Path, PrivateKey]:
    """Goes on with what was begun for the same name at the same CA, or begins: the key is on the disk afterwards."""
    contexts, pinned = home / files.CONTEXTS, invitation.ca_fingerprint.lower()
    entry = f".{context}.enrolling-{pinned[:8]}"
    files.finish_replacement(contexts, entry)
    directory = contexts / entry
    wanted = {"name": invitation.name, "ca_fingerprint": pinned}
    settings = "".join(f"{name} = {json.dumps(value, ensure_ascii=False)}\n" for name, value in wanted.items())
    if directory.is_dir() and files.read(directory / _SETTINGS).split() == settings.split():
        earlier = read_key(directory / files.KEY)
        found: KeyKind = "ed25519" if isinstance(earlier, ed25519.Ed25519PrivateKey) else "p256"
        if kind not in (None, found):
            raise refusal(
                "BAD_ARGUMENT",
                "this enrolment was started with another kind of key",
                found=f"a key of kind {found} in {directory}",
                wanted="the same kind, because the certificate may have been issued already",
                next="leave out the kind of the key",
            )
        return directory, earlier
    made = new_key(kind or "ed25519")
    files.make_directory(contexts)
    with files.changing(home):
        files.replace_directory(contexts, entry, {_SETTINGS: settings, files.KEY: key_pem(made)})
    return directory, made


def new_key(kind: KeyKind) -> PrivateKey:
    """A new key."""
    return ed25519.Ed25519PrivateKey.generate() if kind == "ed25519" else ec.generate_private_key(ec.SECP256R1())


def signing_request(name: str, key: PrivateKey) -> bytes:
    """A certificate signing request (PKCS #10) in DER."""
    subject = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, name)])
    algorithm = None if isinstance(key, ed25519.Ed25519PrivateKey) else hashes.SHA256()
    return x509.CertificateSigningRequestBuilder().subject_name(subject).sign(key, algorithm).public_bytes(Encoding.DER)


async def _knock_at_all(invitation: Invitation, request: bytes) -> enrolment.EnrolResponse:
    """Asks the node, and then those that it names, until one carries the CA."""
    asked = enrolment.EnrolRequest(name=invitation.name, secret=invitation.secret, request=request)
    doors, elsewhere = [invitation.node], None
    for number in range(DOORS_MAX):
        if number == len(doors):
            break
        try:
            answer = await _knock(doors[number], invitation.ca_fingerprint.lower(), asked)
        except Refusal as refused:
            # The first node is the one that the caller named; of the others one may be down.
            if number == 0 or refused.kind is not Kind.UNREACHABLE:
                raise
            continue
        refused_by_it = of_verdict(answer.verdict)
        if refused_by_it is None:
            return answer
        if refused_by_it.name != "CA_ELSEWHERE":
            raise refused_by_it
        elsewhere = elsewhere or refused_by_it
        doors.extend(door for door in answer.carriers if door not in doors)
    assert elsewhere is not None
    raise elsewhere


async def _knock(door: str, pinned: str, request: enrolment.EnrolRequest) -> enrolment.EnrolResponse:
    root = await _pinned(door, pinned)
    try:
        link = await Link.open(door, tls.settings_below(root, None), CONNECT_MAX)
    except Refusal as refused:
        raise await _by_the_clock(refused, door) from refused
    try:
        return await link.ask(link.enrol, request, 2 * CONNECT_MAX)
    finally:
        await link.close()


async def _pinned(door: str, pinned: str) -> bytes:
    """The root with this fingerprint among the certificates that the node presents."""
    _, writer = await tls.connect(door, tls.settings_unverified(None), CONNECT_MAX)
    shown = tls.presented(writer.get_extra_info("ssl_object"))
    writer.close()
    for der in shown:
        if certificate.fingerprint(der) == pinned:
            return der
    raise refusal(
        "UNTRUSTED",
        f"the node at {door} is not trusted: its CA has another fingerprint",
        found=", ".join(map(certificate.fingerprint, shown)),
        wanted=pinned,
        next="ask the operator of the node for the fingerprint of its CA",
    )


async def _by_the_clock(refused: Refusal, door: str) -> Refusal:
    if refused.name not in ("CERTIFICATE_EXPIRED", "CERTIFICATE_NOT_YET_VALID"):
        return refused
    here, told = time.time_ns() // 1000, await told_by_anybody(door, None, CONNECT_MAX)
    return clocks_differ(door, here, told.clock) if told is not None and abs(here - told.clock) > _CLOCK_OFF else refused


def _checked(
    invitation: Invitation, name: str, key: PrivateKey, answer: enrolment.EnrolResponse
) -> tuple[certificate.Organisation, ...]:
    """The organisations of the network, if what was certified is what was asked for."""
    organisations = of_wire(answer.network.organisations)
    pinned = invitation.ca_fingerprint.lower()
    if not any(certificate.fingerprint(root) == pinned for one in organisations for root in one.roots):
        raise refusal(
            "UNTRUSTED",
            f"the node at {invitation.node} describes another network",
            found=f"the organisations {', '.join(one.name for one in organisations)}, none with this CA",
            wanted=f"an organisation with CA {pinned}",
            next="ask the operator of the node for the fingerprint of its CA",
        )
    own = next((one for one in organisations if one.name == answer.organisation), None)
    if own is None or len(answer.network.network) != 32:
        raise _unfit(invitation, f"organisation {answer.organisation!r}, which is not part of the network")
    now = certificate.moment(time.time_ns() // 1000)
    made = certificate.check_own(answer.certificate, answer.chain, own, now)
    if not is_of_key(made, key):
        raise _unfit(invitation, "another key")
    if certificate.common_name(made) != name:
        raise _unfit(invitation, f"the name {certificate.common_name(made)!r}")
    return organisations


def is_of_key(made: x509.Certificate, key: PrivateKey) -> bool:
    """Is the certificate of this key?"""
    form = (Encoding.DER, PublicFormat.SubjectPublicKeyInfo)
    return made.public_key().public_bytes(*form) == key.public_key().public_bytes(*form)


def _unfit(invitation: Invitation, found: str) -> Refusal:
    return refusal(
        "UNTRUSTED",
        f"the node at {invitation.node} certified something else than was asked",
        found=found,
        wanted=f'a certificate of "{invitation.name}" with our key, issued below CA {invitation.ca_fingerprint}',
        next="enrol at another node of the organisation, and inform its admin",
    )


def _nodes(node: str, answer: enrolment.EnrolResponse) -> tuple[str, ...]:
    own: Iterable[str] = ()
    for organisation in answer.network.organisations:
        if organisation.name == answer.organisation:
            own = organisation.addresses
    return tuple(dict.fromkeys((node, *own)))
