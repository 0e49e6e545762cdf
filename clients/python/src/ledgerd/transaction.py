"""Transactions: made, signed and checked as docs/format.md says."""

from __future__ import annotations

import hashlib
import os
from dataclasses import dataclass
from typing import Final, TypeAlias

from cryptography.exceptions import InvalidSignature
from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.asymmetric import ec, ed25519, utils

from ledgerd.refusal import refusal
from ledgerd.v1 import transaction_pb2 as signed

PREFIX: Final = b"ledgerd transaction v1\0"
# Length of the part of a block's hash by which a signer names it.
KNOWN_HASH_BYTES: Final = 8
"""Stands in front of the body in what is signed."""

P256_ORDER: Final = 0xFFFFFFFF00000000FFFFFFFFFFFFFFFFBCE6FAADA7179E84F3B9CAC2FC632551
_ED25519_P: Final = 2**255 - 19
_ED25519_D: Final = -121665 * pow(121666, -1, _ED25519_P)

PrivateKey: TypeAlias = ed25519.Ed25519PrivateKey | ec.EllipticCurvePrivateKey
PublicKey: TypeAlias = ed25519.Ed25519PublicKey | ec.EllipticCurvePublicKey


@dataclass(frozen=True)
class Prepared:
    """A signed transaction that can be given to any node, any number of times."""

    id: bytes
    encoded: bytes

    def introduced(self, certificate: bytes) -> Prepared:
        """The same transaction with the certificate of its creator, which its id does not cover."""
        bare = signed.Transaction.FromString(self.encoded)
        bare.certificate = certificate
        return Prepared(self.id, bare.SerializeToString())


@dataclass(frozen=True)
class Call:
    """A call of a function of a chaincode, with its arguments in order."""

    chaincode: str
    function: str
    args: tuple[bytes, ...]


def prepare(
    call: Call, *, network: bytes, certificate: bytes, key: PrivateKey, not_after: int, known_block: signed.KnownBlock | None = None
) -> Prepared:
    """Signs a call. It is not executed after the block time `not_after`, microseconds since the UNIX epoch. Gates measure its age by
    the newest block that its signer knew.
    """
    body = signed.TransactionBody(
        network=network,
        creator=hashlib.sha256(certificate).digest(),
        nonce=os.urandom(16),
        not_after=not_after,
        chaincode=call.chaincode,
        function=call.function,
        args=call.args,
        known_block=known_block,
    ).SerializeToString()
    encoded = signed.Transaction(body=body, signature=sign(key, PREFIX + body)).SerializeToString()
    return Prepared(hashlib.sha256(body).digest(), encoded)


def sign(key: PrivateKey, message: bytes) -> bytes:
    """A signature in its one form: Ed25519, or P-256 with the lower of the two values of s."""
    if isinstance(key, ed25519.Ed25519PrivateKey):
        return key.sign(message)
    r, s = utils.decode_dss_signature(key.sign(message, ec.ECDSA(hashes.SHA256())))
    return utils.encode_dss_signature(r, min(s, P256_ORDER - s))


def verify(key: object, signature: bytes, message: bytes) -> None:
    """Refuses a signature that is not of this message by this key, in its one form. It refuses a few signatures more
    than nodes do: those of Ed25519 that only ZIP 215 accepts, which nobody makes by accident.
    """
    if not _is_good(key, signature, message):
        raise refusal(
            "BAD_SIGNATURE",
            "the signature is not of this message by its signer",
            wanted="a signature by the key in the signer's certificate, in its one form",
            next="ask another node; tell the operator of this one",
        )


def _is_good(key: object, signature: bytes, message: bytes) -> bool:
    try:
        if isinstance(key, ed25519.Ed25519PublicKey):
            if _is_weak(key):
                return False
            key.verify(signature, message)
            return True
        if not isinstance(key, ec.EllipticCurvePublicKey) or key.curve.name != "secp256r1":
            return False
        r, s = utils.decode_dss_signature(signature)
        if s > P256_ORDER // 2 or signature != utils.encode_dss_signature(r, s):
            return False
        key.verify(signature, message, ec.ECDSA(hashes.SHA256()))
        return True
    except (InvalidSignature, ValueError):
        return False


def _is_weak(key: ed25519.Ed25519PublicKey) -> bool:
    """Is the key of small order? Under such a key one signature fits every message."""
    y = int.from_bytes(key.public_bytes_raw(), "little") % 2**255
    return y * y % _ED25519_P in (0, 1) or (_ED25519_D * y**4 + 2 * y * y - 1) % _ED25519_P == 0
