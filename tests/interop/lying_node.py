"""A node that lies to the robot whose bridge it serves. It has a node's key, and the keys of two users who lie with it.

    lying_node.py HOME NODE_DATA LIE_FILE REPOSITORY

It passes everything on to the node of the context `dev-org2-admin`, and prints the port where it listens. The file says which lie it
tells: `grant` (Farhad holds the robot), `end` (Salma holds it no more) or `withhold` (Salma still holds it). None while it is absent.
"""

import hashlib
import json
import os
import queue
import sys
import tempfile
import threading
import time
from concurrent import futures
from pathlib import Path

import grpc
from grpc_tools import protoc

HOME, DATA, LIE, REPOSITORY = (Path(argument) for argument in sys.argv[1:])
STUBS = tempfile.mkdtemp()
PROTO = REPOSITORY / "crates/api/proto"
NAMES = [f"ledgerd/v1/{name}.proto" for name in ("transaction", "gateway")]
assert protoc.main(["", f"-I{PROTO}", f"--python_out={STUBS}", f"--grpc_python_out={STUBS}", *NAMES]) == 0
sys.path[:0] = [STUBS, str(REPOSITORY / "examples/python-client")]

import client  # noqa: E402
from client import api, signed  # noqa: E402

SERVICE = "Rover/cmd_vel"
TWIST = bytes.fromhex("00010000") + bytes(48)
LIFE_US = 2_000_000
STREAMS = ("Subscribe", "Governance")


def same(message: bytes) -> bytes:
    return message


def micros() -> int:
    return time.time_ns() // 1000


def sign(user: client.Client, function: str, *args: bytes) -> bytes:
    body = signed.TransactionBody(
        network=user.network,
        creator=hashlib.sha256(user.certificate).digest(),
        nonce=os.urandom(16),
        not_after=user.gateway.Status(api.StatusRequest()).clock + LIFE_US,
        chaincode="abac",
        function=function,
        args=(SERVICE.encode(), *args),
    ).SerializeToString()
    signature = user.sign(b"ledgerd transaction v1\0" + body)
    return signed.Transaction(body=body, signature=signature, certificate=user.certificate).SerializeToString()


def event(name: str, payload: dict, user: client.Client | None = None, transaction: bytes = b"") -> api.EventRecord:
    shown = user.certificate if user else b""
    payload = json.dumps(payload).encode()
    return api.EventRecord(
        chaincode="abac", name=name, subject=SERVICE, payload=payload, transaction=transaction, certificate=shown
    )


def command(user: client.Client, epoch: int) -> api.EventRecord:
    return event("message", {}, user, sign(user, "set", str(epoch).encode(), str(micros()).encode(), TWIST))


class Lies(grpc.GenericRpcHandler):
    """Every call as it came, but for what it tells the robot."""

    def __init__(self):
        context = HOME / "contexts/dev-org2-admin"
        key, chain = ((context / name).read_bytes() for name in ("key.pem", "certificate.pem"))
        self.node = client.channel(context, key, chain)
        self.salma, self.farhad = (client.Client(HOME / "contexts" / name) for name in ("Salma", "Farhad"))

    def service(self, details):
        method = details.method
        name = method.rsplit("/", 1)[1]
        if name == "SubmitStream":
            call = self.node.stream_stream(method, same, same)
            return grpc.stream_stream_rpc_method_handler(lambda sent, at: self.answers(call(sent), at), same, same)
        if name in STREAMS:
            call = self.node.unary_stream(method, same, same)
            answers = self.deliveries if name == "Subscribe" else lambda asked, call, at: self.answers(call(asked), at)
            return grpc.unary_stream_rpc_method_handler(lambda asked, at: answers(asked, call, at), same, same)
        call = self.node.unary_unary(method, same, same)
        return grpc.unary_unary_rpc_method_handler(lambda asked, at: self.answer(call, asked, at), same, same)

    def answer(self, call, asked, at):
        try:
            return call(asked, timeout=10)
        except grpc.RpcError as refused:
            at.abort(refused.code(), refused.details())

    def answers(self, call, at):
        at.send_initial_metadata(())
        yield from call

    def deliveries(self, asked, call, at):
        at.send_initial_metadata(())
        request = api.SubscribeRequest.FromString(asked)
        came: queue.Queue = queue.Queue()
        threading.Thread(target=lambda: [came.put(delivery) for delivery in call(asked)], daemon=True).start()
        height, epoch, ended, has_granted = request.from_height, 0, 0.0, False
        while at.is_active():
            try:
                delivery = api.Delivery.FromString(came.get(timeout=0.05))
            except queue.Empty:
                delivery = None
            lie = LIE.read_text().strip() if LIE.exists() and "message" in request.names else ""
            if delivery:
                height = max(height, delivery.height)
                epoch = max([epoch] + [json.loads(e.payload)["epoch"] for e in delivery.events if e.name == "granted"])
                if lie == "withhold":
                    kept = [e for e in delivery.events if e.name == "message"]
                    delivery = api.Delivery(height=delivery.height, time=delivery.time, events=kept)
                if lie == "end" and time.monotonic() - ended > 0.5:
                    ended = time.monotonic()
                    made_up = {"service": SERVICE, "holder": "Org1/Salma", "epoch": 2**60, "reason": "released"}
                    delivery.events.append(event("released", made_up))
                    delivery.time = 2**62
                yield delivery.SerializeToString()
            if lie == "grant":
                height += 1
                now = micros()
                grant = {"service": SERVICE, "holder": "Org1/Farhad", "epoch": 99, "expires": now + 10**9}
                grant |= {"mode": "exclusive", "acquired_at": now, "lease_ms": 600_000, "next_seq": 1}
                told = [] if has_granted else [event("granted", grant, self.farhad, sign(self.farhad, "acquire"))]
                has_granted = True
                yield api.Delivery(height=height, time=now, events=[*told, command(self.farhad, 99)]).SerializeToString()
            if lie == "withhold":
                height += 1
                made_up = api.Delivery(height=height, time=micros(), events=[command(self.salma, epoch)])
                yield made_up.SerializeToString()


def main() -> None:
    server = grpc.server(futures.ThreadPoolExecutor(32))
    server.add_generic_rpc_handlers((Lies(),))
    credentials = grpc.ssl_server_credentials([((DATA / "node.key").read_bytes(), (DATA / "node.pem").read_bytes())])
    port = server.add_secure_port("127.0.0.1:0", credentials)
    server.start()
    print(port, flush=True)
    server.wait_for_termination()


if __name__ == "__main__":
    main()
