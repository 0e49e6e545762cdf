"""A client in Python, made from docs/format.md alone: takes a robot, sends it one Twist, and hears it again.

    python3 -m venv venv && venv/bin/pip install grpcio grpcio-tools cryptography
    venv/bin/python -m grpc_tools.protoc -I ../../crates/api/proto --python_out=. --grpc_python_out=. \\
        ledgerd/v1/transaction.proto ledgerd/v1/gateway.proto
    venv/bin/python client.py ~/.config/ledgerd/contexts/Salma Turtlebot4/cmd_vel

The argument is a context that `ledgerctl enroll` made.
"""

import hashlib
import json
import os
import ssl
import sys
import time
import tomllib
from pathlib import Path

import grpc
from cryptography import x509
from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.asymmetric import ec, utils
from cryptography.hazmat.primitives.serialization import Encoding, load_pem_private_key
from ledgerd.v1 import gateway_pb2 as api
from ledgerd.v1 import gateway_pb2_grpc as services
from ledgerd.v1 import transaction_pb2 as signed

P256_ORDER = 0xFFFFFFFF00000000FFFFFFFFFFFFFFFFBCE6FAADA7179E84F3B9CAC2FC632551
# How long a call may be executed.
LIFE_S = 30
# A command is worth nothing after two seconds.
COMMAND_LIFE_S = 2
# How long one answer is waited for. A call is tried for so much longer than it can be executed.
ANSWER_S = 5


class Client:
    """A connection as the identity of a context."""

    def __init__(self, context: Path):
        settings = tomllib.loads((context / "context.toml").read_text())
        chain, key = (context / "certificate.pem").read_bytes(), (context / "key.pem").read_bytes()
        self.network = bytes.fromhex(settings["network"])
        self.key = load_pem_private_key(key, None)
        self.certificate = x509.load_pem_x509_certificate(chain).public_bytes(Encoding.DER)
        self.gateway = services.GatewayStub(channel(context, key, chain))

    def call(self, chaincode: str, function: str, *args: bytes, life: int = LIFE_S) -> api.SubmitResponse:
        """Signs a call, submits it, and waits for its verdict."""
        body = signed.TransactionBody(
            network=self.network,
            creator=hashlib.sha256(self.certificate).digest(),
            nonce=os.urandom(16),
            not_after=self.gateway.Status(api.StatusRequest()).clock + life * 1_000_000,
            chaincode=chaincode,
            function=function,
            args=args,
        ).SerializeToString()
        signature = self.sign(b"ledgerd transaction v1\0" + body)
        transaction = signed.Transaction(body=body, signature=signature, certificate=self.certificate)
        request = api.SubmitRequest(transaction=transaction.SerializeToString(), first_attempt=True)
        answer = self.send(request, until=time.monotonic() + life + ANSWER_S)
        if answer.verdict.code != 0:
            verdict = answer.verdict
            sys.exit(f"LGR-{verdict.code}: {verdict.message}\n  found   {verdict.found}\n  wanted  {verdict.wanted}")
        return answer

    def send(self, request: api.SubmitRequest, until: float) -> api.SubmitResponse:
        """Submits; again as long as nobody knows what became of it. The node executes it once."""
        while True:
            try:
                answer = self.gateway.Submit(request, timeout=ANSWER_S)
                if answer.height or answer.verdict.code < 4000 or time.monotonic() > until:
                    return answer
            except grpc.RpcError:
                if time.monotonic() > until:
                    raise
            # From now on a copy may be on its way: only the chain can tell what became of it.
            request.first_attempt = False
            time.sleep(0.1)

    def sign(self, message: bytes) -> bytes:
        """Ed25519, or P-256 with the lower of the two values of s."""
        if not isinstance(self.key, ec.EllipticCurvePrivateKey):
            return self.key.sign(message)
        r, s = utils.decode_dss_signature(self.key.sign(message, ec.ECDSA(hashes.SHA256())))
        return utils.encode_dss_signature(r, min(s, P256_ORDER - s))


def channel(context: Path, key: bytes | None, chain: bytes | None) -> grpc.Channel:
    """A connection to the first node of a context, as whom the certificate names, or as nobody."""
    node = tomllib.loads((context / "context.toml").read_text())["nodes"][0]
    # Names do not matter between nodes and clients, but this library insists: take the one that the node shows.
    shown = ssl.get_server_certificate(tuple(node.rsplit(":", 1)))
    names = x509.load_pem_x509_certificate(shown.encode()).extensions
    name = names.get_extension_for_class(x509.SubjectAlternativeName).value.get_values_for_type(x509.DNSName)[0]
    credentials = grpc.ssl_channel_credentials(roots(context), key, chain)
    return grpc.secure_channel(node, credentials, [("grpc.ssl_target_name_override", name)])


def roots(context: Path) -> bytes:
    """The roots of all organisations in PEM."""
    organisations = json.loads((context / "msps.json").read_text())
    return "".join(root for organisation in organisations for root in organisation["roots"]).encode()


def main() -> None:
    context, service = Path(sys.argv[1]).expanduser(), sys.argv[2]
    client = Client(context)
    grant = json.loads(client.call("abac", "acquire", service.encode()).response)
    print(f"{service} is held with epoch {grant['epoch']}")
    twist = bytes.fromhex("00010000") + bytes(48)
    numbers = [str(grant[name]).encode() for name in ("epoch", "next_seq")]
    height = client.call("abac", "set", service.encode(), *numbers, twist, life=COMMAND_LIFE_S).height
    print(f"published in block {height}")
    request = api.SubscribeRequest(from_height=height, chaincode="abac", subjects=[service], names=["message"])
    for delivery in client.gateway.Subscribe(request):
        for event in delivery.events:
            transaction = signed.Transaction.FromString(event.transaction)
            body = signed.TransactionBody.FromString(transaction.body)
            print(f"heard {body.args[3].hex()} in block {delivery.height}")
            return


if __name__ == "__main__":
    main()
