"""Contexts: who this machine is on which network. The files are those of `ledgerctl`."""

from __future__ import annotations

import dataclasses
import difflib
import json
import sys
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final, Literal, TypeAlias

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

from cryptography.hazmat.primitives.asymmetric import ec, ed25519
from cryptography.hazmat.primitives.serialization import Encoding, NoEncryption, PrivateFormat, load_pem_private_key

from ledgerd import certificate, files
from ledgerd.certificate import Organisation
from ledgerd.refusal import Refusal, refusal
from ledgerd.transaction import PrivateKey
from ledgerd.v1 import enrolment_pb2 as enrolment

Rule: TypeAlias = Literal["auto", "never"]

_ORGANISATIONS_MAX: Final = 256
_NODES_MAX: Final = 256
_ADDRESS_BYTES_MAX: Final = 262
_ENROL: Final = "ledgerctl enroll NAME --node HOST:PORT --ca-fingerprint SHA256 --secret S"


@dataclass(frozen=True)
class Known:
    """The network as it was learnt since the enrolment: nodes with their organisations, the node that served last, and all
    organisations if they are others than at enrolment.
    """

    nodes: tuple[tuple[str, str], ...] = ()
    last: str | None = None
    organisations: tuple[Organisation, ...] = ()


@dataclass(frozen=True)
class Context:
    """The identity of this machine on a network, and the way to reach it."""

    name: str
    organisation: str
    network: bytes
    label: str
    nodes: tuple[str, ...]
    chain: tuple[bytes, ...]
    key: PrivateKey = field(repr=False)
    organisations: tuple[Organisation, ...] = field(repr=False)
    renew: Rule = "auto"
    known: Known = field(default=Known(), repr=False)
    home: Path | None = None

    @property
    def id(self) -> str:
        """The identity, such as `Org1/Salma`."""
        return f"{self.organisation}/{certificate.common_name(certificate.parse(self.chain[0]))}"

    @classmethod
    def load(cls, name: str | None = None, home: Path | None = None) -> Context:
        """Reads the context of this name; without a name, the selected one."""
        place = home or files.home()
        with files.reading(place):
            return cls._read(place, name)

    @classmethod
    def _read(cls, home: Path, name: str | None) -> Context:
        name = current(home) if name is None else name
        if name is None:
            raise _none_selected(home)
        directory = _directory_of(home, name)
        path = directory / files.SETTINGS
        settings = _toml(path)
        chain_path, key_path, msps_path = (directory / file for file in (files.CERTIFICATE, files.KEY, files.MSPS))
        try:
            network = bytes.fromhex(settings["network"])
            organisation, nodes = str(settings["organisation"]), tuple(str(node) for node in settings["nodes"])
            rule = _rule(settings.get("renew", "auto"))
        except (KeyError, TypeError, ValueError) as error:
            raise files.bad_file(path, f"a missing or wrong setting: {error}") from error
        if settings.get("name") != name or not nodes or len(network) != 32:
            wanted = f'name = "{name}", as its directory is called, a network, and at least one node'
            raise files.bad_file(path, f"name {settings.get('name')!r} and {len(nodes)} nodes", wanted=wanted)
        try:
            chain = certificate.ders(files.read(chain_path))
        except ValueError as error:
            raise files.bad_file(chain_path, str(error), wanted='PEM with "BEGIN CERTIFICATE"') from error
        key = read_key(key_path)
        if certificate.parse(chain[0]).public_key() != key.public_key():
            raise files.bad_file(chain_path, "a certificate of another key than the one beside it")
        try:
            organisations = _organisations(json.loads(files.read(msps_path)))
        except (KeyError, TypeError, ValueError) as error:
            raise files.bad_file(msps_path, str(error)) from error
        label, known = str(settings.get("label", "")), _known(directory)
        return cls(name, organisation, network, label, nodes, chain, key, organisations, rule, known, home)

    def save(self, home: Path | None = None) -> Context:
        """Writes the context below `home`, in the place of one of the same name. The first one that is stored becomes the
        selected one.
        """
        files.check_name(self.name)
        place = home or self.home or files.home()
        files.make_directory(place / files.CONTEXTS)
        with files.changing(place):
            files.replace_directory(place / files.CONTEXTS, self.name, self._content())
            if current(place) is None:
                files.replace_file(place, files.CURRENT, f"{self.name}\n")
        return dataclasses.replace(self, home=place)

    def certified(self, chain: Sequence[bytes], key: PrivateKey) -> Context:
        """Stores a new certificate and its key, and leaves everything else as it is on the disk now."""
        place = self.home or files.home()
        with files.changing(place):
            stored = dataclasses.replace(self._read(place, self.name), chain=tuple(chain), key=key)
            files.replace_directory(place / files.CONTEXTS, self.name, stored._content())
        return stored

    def _content(self) -> dict[str, str]:
        settings = {
            "name": self.name,
            "organisation": self.organisation,
            "network": self.network.hex(),
            "label": self.label,
        }
        lines = [f"{key} = {_toml_text(value)}" for key, value in settings.items()]
        lines.append(f"nodes = [{', '.join(map(_toml_text, self.nodes))}]")
        if self.renew != "auto":
            lines.append(f'renew = "{self.renew}"')
        content = {
            files.SETTINGS: "\n".join(lines) + "\n",
            files.CERTIFICATE: certificate.pem(self.chain),
            files.KEY: key_pem(self.key),
            files.MSPS: json.dumps(_stored(self.organisations), indent=2, ensure_ascii=False),
        }
        if self.known != Known():
            content[files.NODES] = self._nodes()
        return content

    def _nodes(self) -> str:
        known: dict[str, Any] = {
            "nodes": [{"address": address, "organisation": name} for address, name in self.known.nodes],
            "last": self.known.last,
        }
        if self.known.organisations:
            known["organisations"] = _stored(self.known.organisations)
        return json.dumps(known, indent=2, ensure_ascii=False)

    def addresses(self) -> list[str]:
        """The addresses at which a node may answer, in the order to try them: the one that served last, the one that was
        given at enrolment, those of the own organisation, and the others.
        """
        told = [address for address, _ in self.known.nodes]
        last = [one for one in (self.known.last,) if one in self.nodes or one in told]
        own = [address for address, organisation in self.known.nodes if organisation == self.organisation]
        given = [address for address in self.nodes if address in told]
        ordered = [*last, self.nodes[0], *own, *given, *told, *self.nodes]
        return [address for address in dict.fromkeys(ordered) if address is not None]

    def learn(self, told: enrolment.NetworkResponse, address: str) -> Context:
        """The same context with what a node, whose certificate was verified, has told of the network."""
        nodes = tuple(
            (node, organisation.name)
            for organisation in told.organisations
            for node in organisation.addresses
            if is_address(node)
        )
        organisations = of_wire(told.organisations)
        differ = set(organisations) != set(self.organisations)
        known = Known(nodes[:_NODES_MAX], address, organisations if differ else ())
        return self if known == self.known else dataclasses.replace(self, known=known)

    def note(self) -> None:
        """Keeps on the disk what was learnt, if the context is stored and holds something else. A context that cannot be
        written is no reason to fail: what was learnt is learnt again.
        """
        if self.home is None:
            return
        directory = self.home / files.CONTEXTS / self.name
        try:
            if _known(directory) == self.known:
                return
            with files.changing(self.home, files.NOTE_WAITS_MAX):
                files.replace_file(directory, files.NODES, self._nodes())
        except Refusal:
            return

    def trusted_roots(self) -> str:
        """The roots of all organisations whose nodes are talked to, in PEM."""
        all_roots = [root for one in (*self.organisations, *self.known.organisations) for root in one.roots]
        return certificate.pem(dict.fromkeys(all_roots))


def names(home: Path | None = None) -> list[str]:
    """The names of all stored contexts, in order."""
    contexts = (home or files.home()) / files.CONTEXTS
    found = set()
    entries = contexts.iterdir() if contexts.is_dir() else iter(())
    for entry in entries:
        name = entry.name.removeprefix(".").removesuffix(".old") if entry.name.startswith(".") else entry.name
        is_context = not entry.name.startswith(".") or entry.name.endswith(".old")
        if is_context and entry.is_dir() and is_name(name):
            found.add(name)
    return sorted(found)


def is_name(name: str) -> bool:
    """May a context have this name?"""
    try:
        files.check_name(name)
    except Refusal:
        return False
    return True


def current(home: Path | None = None) -> str | None:
    """The name of the selected context, if one is selected."""
    path = (home or files.home()) / files.CURRENT
    return (files.read(path).strip() or None) if path.exists() else None


def is_address(address: str) -> bool:
    """Is it HOST:PORT?"""
    host, colon, port = address.rpartition(":")
    return bool(colon and host) and len(address) <= _ADDRESS_BYTES_MAX and port.isdecimal() and 0 < int(port) < 65536


def key_pem(key: PrivateKey) -> str:
    """A key as PKCS #8 in PEM."""
    return key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption()).decode()


def of_wire(told: Iterable[enrolment.Organisation]) -> tuple[Organisation, ...]:
    """The organisations that a node tells; each certificate is read, so that nothing else is taken."""
    found = tuple(Organisation(one.name, tuple(one.roots), tuple(one.intermediates)) for one in told)
    if len(found) > _ORGANISATIONS_MAX:
        raise refusal("TOO_LARGE", "the network has too many organisations", found=str(len(found)))
    for organisation in found:
        for der in (*organisation.roots, *organisation.intermediates):
            certificate.parse(der)
    return tuple(sorted(found, key=lambda one: one.name))


def _directory_of(home: Path, name: str) -> Path:
    files.check_name(name)
    files.finish_replacement(home / files.CONTEXTS, name)
    directory = home / files.CONTEXTS / name
    if directory.is_dir():
        return directory
    known = names(home)
    near = difflib.get_close_matches(name, known, 1)
    advice = f'did you mean "{near[0]}"?' if near else ("ledgerctl context list" if known else _ENROL)
    wanted = "the name of a stored context"
    raise refusal("NO_CONTEXT", f'there is no context "{name}"', found=_listed(home, known), wanted=wanted, next=advice)


def _none_selected(home: Path) -> Refusal:
    known = names(home)
    if not known:
        wanted, advice = "the context of an enrolled identity", _ENROL
    else:
        wanted, advice = "one of them", f"name it: {known[0]}, or: ledgerctl context use {known[0]}"
    return refusal("NO_CONTEXT", "no context is selected", found=_listed(home, known), wanted=wanted, next=advice)


def _listed(home: Path, known: Sequence[str]) -> str:
    return f"contexts {', '.join(known)}" if known else f"no contexts in {home / files.CONTEXTS}"


def _toml(path: Path) -> dict[str, Any]:
    try:
        settings: dict[str, Any] = tomllib.loads(files.read(path))
    except tomllib.TOMLDecodeError as error:
        raise files.bad_file(path, str(error)) from error
    return settings


def _toml_text(value: str) -> str:
    """A basic string of TOML; but for one character it is a string of JSON."""
    return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007F")


def _rule(value: object) -> Rule:
    if value == "auto" or value == "never":
        return "never" if value == "never" else "auto"
    raise ValueError(f"renew = {value!r}, wanted auto or never")


def read_key(path: Path) -> PrivateKey:
    """Reads a private key that only its owner may read."""
    try:
        key = load_pem_private_key(files.read_secret(path).encode(), None)
    except (TypeError, ValueError) as error:
        raise files.bad_file(path, str(error)) from error
    if isinstance(key, ed25519.Ed25519PrivateKey):
        return key
    if isinstance(key, ec.EllipticCurvePrivateKey) and isinstance(key.curve, ec.SECP256R1):
        return key
    raise files.bad_file(path, "a key of another kind", wanted="Ed25519 or P-256")


def _organisations(stored: Any) -> tuple[Organisation, ...]:
    if not isinstance(stored, list) or len(stored) > _ORGANISATIONS_MAX:
        raise ValueError(f"not a list of at most {_ORGANISATIONS_MAX} organisations")
    read = [
        Organisation(
            str(one["organisation"]),
            tuple(der for text in one["roots"] for der in certificate.ders(text)),
            tuple(der for text in one.get("intermediates", ()) for der in certificate.ders(text)),
        )
        for one in stored
    ]
    return tuple(sorted(read, key=lambda one: one.name))


def _stored(organisations: Iterable[Organisation]) -> list[dict[str, Any]]:
    found = []
    for one in organisations:
        entry: dict[str, Any] = {"organisation": one.name, "roots": [certificate.pem([root]) for root in one.roots]}
        if one.intermediates:
            entry["intermediates"] = [certificate.pem([der]) for der in one.intermediates]
        found.append(entry)
    return found


def _known(directory: Path) -> Known:
    """What was learnt. It never fails: what cannot be used is learnt again."""
    try:
        stored = json.loads(files.read(directory / files.NODES))
        nodes = tuple((str(one["address"]), str(one["organisation"])) for one in stored.get("nodes", ()))
        return Known(nodes, stored.get("last"), _organisations(stored.get("organisations", [])))
    except (AttributeError, KeyError, Refusal, TypeError, ValueError):
        return Known()
