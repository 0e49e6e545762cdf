"""Checks the signature of a node: docs/format.md, "Certificates" and "Hashes and signatures".

It accepts no path or signature that a node refuses, and refuses more: certificates with name constraints, extended key
usages of a root, and Ed25519 signatures that only ZIP 215 accepts.
"""

import hashlib
import json

from cryptography import x509
from cryptography.exceptions import InvalidSignature
from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.asymmetric import ec, ed25519, utils
from cryptography.hazmat.primitives.serialization import Encoding, PublicFormat
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID, SignatureAlgorithmOID

ROLES = {"member", "client", "admin", "robot", "node", "peer", "orderer"}
NODES = {"node", "peer", "orderer"}
PURPOSES = {ExtendedKeyUsageOID.CLIENT_AUTH, ExtendedKeyUsageOID.ANY_EXTENDED_KEY_USAGE}
AUTHORITIES_SIGN_WITH = {
    SignatureAlgorithmOID.ED25519,
    SignatureAlgorithmOID.ECDSA_WITH_SHA256,
    SignatureAlgorithmOID.ECDSA_WITH_SHA384,
}
P256_ORDER = 0xFFFFFFFF00000000FFFFFFFFFFFFFFFFBCE6FAADA7179E84F3B9CAC2FC632551
ED25519_P, ED25519_D = 2**255 - 19, -121665 * pow(121666, -1, 2**255 - 19)


def need(holds, otherwise):
    if not holds:
        raise ValueError(otherwise)


def is_usable(certificate, time, below=None):
    """May it be used at this block time by a signer, or by an authority with so many authorities below it?"""
    known = x509.BasicConstraints, x509.KeyUsage, x509.ExtendedKeyUsage
    found = {type(one.value): one.value for one in certificate.extensions}
    basic, usage, purposes = (found.get(kind) for kind in known)
    strange = {type(one.value) for one in certificate.extensions if one.critical} - set(known)
    begin, end = certificate.not_valid_before_utc.timestamp(), certificate.not_valid_after_utc.timestamp()
    if certificate.version != x509.Version.v3 or strange or x509.NameConstraints in found:
        return False
    if not begin <= time // 1_000_000 <= end or (purposes is not None and PURPOSES.isdisjoint(purposes)):
        return False
    is_authority = basic is not None and basic.ca
    if below is None:
        return not is_authority and (usage is None or usage.digital_signature)
    short = is_authority and (basic.path_length is None or below <= basic.path_length)
    return short and (usage is None or usage.key_cert_sign)


def is_issued(certificate, time, roots, others, below=0):
    """Does a path lead over other authorities of the organisation to one of its roots?"""
    for issuer in roots + others:
        try:
            certificate.verify_directly_issued_by(issuer)
        except (InvalidSignature, TypeError, ValueError):
            continue
        further = [other for other in others if other != issuer]
        if is_usable(issuer, time, below) and certificate.signature_algorithm_oid in AUTHORITIES_SIGN_WITH:
            if issuer in roots or is_issued(issuer, time, roots, further, below + 1):
                return True
    return False


def revocation(certificate):
    """The name of a certificate among the revoked ones: its issuer and its serial number."""
    serial = certificate.serial_number
    number = serial.to_bytes(serial.bit_length() // 8 + 1, "big")
    return hashlib.sha256(certificate.issuer.public_bytes()).digest() + number


def check(key, message, signature):
    """Refuses a signature that is not of this message by this key, in its one form."""
    if isinstance(key, ed25519.Ed25519PublicKey):
        y = int.from_bytes(key.public_bytes_raw(), "little") % 2**255
        weak = y * y % ED25519_P in (0, 1) or (ED25519_D * y**4 + 2 * y * y - 1) % ED25519_P == 0
        need(not weak, "one signature fits every message under a key of small order")
        return key.verify(signature, message)
    r, s = utils.decode_dss_signature(signature)
    need(key.curve.name == "secp256r1", "a key is Ed25519 or P-256")
    need(s <= P256_ORDER // 2 and signature == utils.encode_dss_signature(r, s), "a signature has one form")
    return key.verify(signature, message, ec.ECDSA(hashes.SHA256()))


def strict_quorum(voters, owners):
    """The signatures of a strict certificate: more than half of the voters and those of the largest hand, never more than all."""
    return min((voters + max(map(owners.count, owners))) // 2 + 1, voters)


def quorum(records, nodes, group):
    """How many of a group of voters must sign, of how many hands, and the hand of each: its organisation, or the first of those
    under one hand."""
    rule = json.loads(records.get(b"msp\0certificates", b"{}"))
    shared = {name: min(hand) for hand in rule.get("hands", []) for name in hand}
    owners = {node: nodes[node]["organisation"] for node in group if node in nodes}
    hands = {node: shared.get(owner, owner) for node, owner in owners.items()}
    needed = strict_quorum(len(group), list(hands.values())) if "strict_since" in rule else len(group) // 2 + 1
    return needed, min(2, len(set(hands.values()))), hands


def read_authorities(organisations):
    """Roots and other authorities by organisation. No two organisations may share one."""
    read = lambda ders: [x509.load_der_x509_certificate(bytes.fromhex(der)) for der in ders]
    found = {each["name"]: (read(each["roots"]), read(each.get("intermediates", []))) for each in organisations}
    owners = {}
    for organisation, (roots, others) in found.items():
        for authority in roots + others:
            key = authority.public_key().public_bytes(Encoding.DER, PublicFormat.SubjectPublicKeyInfo)
            for claim in (authority.subject.public_bytes(), key):
                need(owners.setdefault(claim, organisation) == organisation, "two organisations share an authority")
    return found


def check_node(node, authorities, records, time, der, message, signature):
    """Refuses a signature unless the node made it, with a certificate from an authority of its organisation."""
    certificate = x509.load_der_x509_certificate(der)
    named = lambda oid: [value.value for value in certificate.subject.get_attributes_for_oid(oid)]
    roles = ROLES.intersection(named(NameOID.ORGANIZATIONAL_UNIT_NAME))
    need(named(NameOID.COMMON_NAME) == [node["name"]], "a certificate of somebody else")
    need(roles and roles <= NODES, "a certificate of no node")
    need(is_usable(certificate, time), "a certificate that may not be used at this time, or not to sign")
    need(is_issued(certificate, time, *authorities[node["organisation"]]), "a certificate of no authority of its own")
    need(b"msp\0revoked/" + revocation(certificate) not in records, "a revoked certificate")
    check(certificate.public_key(), message, signature)
