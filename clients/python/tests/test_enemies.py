"""What a client meets that means it harm, or is broken: clocks, certificates, liars, silence."""

from __future__ import annotations

import asyncio
import contextlib
import datetime
import hashlib
import socket
import ssl
import subprocess
import sys
import tempfile
import threading
import unittest
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any
from unittest import mock

import ledgerd
from cryptography import x509
from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.asymmetric import ec, ed25519, utils
from cryptography.hazmat.primitives.serialization import Encoding
from cryptography.x509.oid import NameOID
from ledgerd import certificate, events, link, tls, transaction
from ledgerd.context import Known, key_pem
from ledgerd.events import Deliveries, Wanted
from ledgerd.link import Link
from ledgerd.refusal import of_status
from ledgerd.renewal import renew_if_due
from ledgerd.senders import Senders
from ledgerd.v1 import gateway_pb2 as api
from ledgerd.v1 import transaction_pb2 as signed
from network import PATIENCE, SERVICE, TWIST, Dev, Three, eventually, number_of, numbered


class Relay:
    """Stands between a client and a node. It passes bytes on until it is told to be silent."""

    def __init__(self, node: str) -> None:
        self.node = node
        self.silent = threading.Event()
        self.listener = socket.create_server(("127.0.0.1", 0))
        self.address = f"127.0.0.1:{self.listener.getsockname()[1]}"
        self.open: list[socket.socket] = []
        threading.Thread(target=self._accept, daemon=True).start()

    def _accept(self) -> None:
        with contextlib.suppress(OSError):
            while True:
                near, _ = self.listener.accept()
                host, port = self.node.rsplit(":", 1)
                far = socket.create_connection((host, int(port)))
                self.open += [near, far]
                for way in ((near, far), (far, near)):
                    threading.Thread(target=self._carry, args=way, daemon=True).start()

    def _carry(self, source: socket.socket, sink: socket.socket) -> None:
        with contextlib.suppress(OSError):
            while chunk := source.recv(65536):
                if not self.silent.is_set():
                    sink.sendall(chunk)
        with contextlib.suppress(OSError):
            sink.shutdown(socket.SHUT_RDWR)

    def close(self) -> None:
        self.listener.close()
        for one in self.open:
            one.close()


def made(name: str, role: str, key: Any, issuer: Any = None, life: tuple[int, int] = (-1, 1)) -> x509.Certificate:
    """A certificate for a key; without an issuer (name, key) an authority of its own. `life` in days from now."""
    subject = x509.Name(
        [x509.NameAttribute(NameOID.COMMON_NAME, name), x509.NameAttribute(NameOID.ORGANIZATIONAL_UNIT_NAME, role)]
    )
    signer_name, signer = issuer or (subject, key)
    now = datetime.datetime.now(datetime.timezone.utc)
    builder = (
        x509.CertificateBuilder()
        .subject_name(subject)
        .issuer_name(signer_name)
        .public_key(key.public_key())
        .serial_number(x509.random_serial_number())
        .not_valid_before(now + datetime.timedelta(days=life[0]))
        .not_valid_after(now + datetime.timedelta(days=life[1]))
        .add_extension(x509.BasicConstraints(ca=issuer is None, path_length=None), critical=True)
    )
    return builder.sign(signer, None if isinstance(signer, ed25519.Ed25519PrivateKey) else hashes.SHA256())


def der(one: x509.Certificate) -> bytes:
    return one.public_bytes(Encoding.DER)


@contextlib.contextmanager
def player(chain_and_key: str) -> Iterator[str]:
    """Shows a certificate to whoever connects, and says nothing."""
    settings = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    settings.set_alpn_protocols(["h2"])
    tls._show(settings, chain_and_key)
    with socket.create_server(("127.0.0.1", 0)) as listener:

        def play() -> None:
            with contextlib.suppress(OSError):
                while True:
                    near, _ = listener.accept()
                    with contextlib.suppress(OSError), settings.wrap_socket(near, server_side=True) as secured:
                        secured.recv(1)

        threading.Thread(target=play, daemon=True).start()
        yield f"127.0.0.1:{listener.getsockname()[1]}"


class Enemies(unittest.TestCase):
    network: Dev

    @classmethod
    def setUpClass(cls) -> None:
        cls.network = Dev()
        for name in ("Salma", "Omar"):
            cls.network.enrol(Dev.ADMIN, name, "Turtlebot4")

    @classmethod
    def tearDownClass(cls) -> None:
        cls.network.close()

    def context(self, name: str = "Salma") -> ledgerd.Context:
        return ledgerd.Context.load(name, self.network.home)

    def refused(self, context: ledgerd.Context) -> ledgerd.Refusal:
        """Why this context cannot connect."""
        with self.assertRaises(ledgerd.Refusal) as refused:
            ledgerd.connect(replace(context, home=None), deadline=5)
        return refused.exception

    def test_a_node_of_another_ca_is_not_believed(self) -> None:
        key = ec.generate_private_key(ec.SECP256R1())
        other = certificate.Organisation("Org1", (der(made("ca", "ca", key)),))
        found = self.refused(replace(self.context(), organisations=(other,), known=Known()))
        self.assertEqual((found.name, found.kind), ("UNTRUSTED", ledgerd.Kind.DENIED))
        self.assertIn("is not trusted", found.message)

    def test_a_certificate_that_no_organisation_issued_is_refused_with_a_reason(self) -> None:
        key = ec.generate_private_key(ec.SECP256R1())
        own = made("Salma", "member", key, (made("ca", "ca", key).subject, key))
        self.assertEqual(self.refused(replace(self.context(), chain=(der(own),), key=key)).name, "UNTRUSTED")

    def test_a_certificate_that_has_expired_says_so_and_who_helps(self) -> None:
        key = ec.generate_private_key(ec.SECP256R1())
        own = made("Salma", "member", key, (made("ca", "ca", key).subject, key), (-9, -2))
        found = self.refused(replace(self.context(), chain=(der(own),), key=key))
        self.assertEqual(found.name, "CERTIFICATE_EXPIRED")
        self.assertIn("ledgerctl identity register Salma --reissue", found.next)

    def test_a_revoked_identity_is_refused_and_told(self) -> None:
        self.network.enrol(Dev.ADMIN, "Revoked", "Turtlebot4")
        with ledgerd.connect("Revoked", home=self.network.home) as robot, robot.acquire(SERVICE):
            self.network.ctl(Dev.ADMIN, "identity", "revoke", "Revoked")
            with self.assertRaises(ledgerd.Refusal) as refused:
                robot.call("abac", "renew", SERVICE.encode())
            self.assertIn(refused.exception.name, ("REVOKED", "NOT_HOLDER"))
        self.assertEqual(self.refused(self.context("Revoked")).name, "REVOKED")

    def test_the_network_that_was_made_anew_says_so(self) -> None:
        found = self.refused(replace(self.context(), network=bytes(32)))
        self.assertEqual(found.name, "WRONG_NETWORK")
        self.assertIn(self.network.facts["network"], found.found)

    def test_a_user_who_plays_the_node_is_not_believed(self) -> None:
        """A certificate of an organisation is not enough: its role counts."""
        authority = ec.generate_private_key(ec.SECP256R1())
        root = made("ca", "ca", authority)
        organisation = certificate.Organisation("Org1", (der(root),))
        for role, wanted in (("member", "WRONG_ROLE"), ("admin", "WRONG_ROLE"), ("node", "UNREACHABLE")):
            key = ec.generate_private_key(ec.SECP256R1())
            shown = made("Omar", role, key, (root.subject, authority))
            with player(certificate.pem([der(shown)]) + key_pem(key)) as address:
                context = replace(self.context(), nodes=(address,), organisations=(organisation,), known=Known())
                found = self.refused(context)
            self.assertEqual(found.name, wanted, found)
            if role != "node":
                self.assertEqual(found.found, f"Omar with role {role}")

    def test_a_clock_that_is_wrong_is_told_as_such(self) -> None:
        environment = {**self.network.environment, "SKEW": str(400 * 86400)}
        done = subprocess.run([sys.executable, "-c", _SKEWED], env=environment, capture_output=True, check=False)
        said = done.stdout.decode()
        self.assertTrue(said.startswith("CLOCK_OFF"), said + done.stderr.decode())
        self.assertIn("ahead of that of the node", said)

    def test_commands_are_dated_by_the_clock_of_the_node(self) -> None:
        """A machine whose wall clock is an hour off, by which certificates are still good, publishes all the same."""
        environment = {**self.network.environment, "SKEW": str(3600)}
        done = subprocess.run([sys.executable, "-c", _SKEWED], env=environment, capture_output=True, check=False)
        self.assertEqual(done.stdout.decode(), "published\n", done.stderr.decode())

    def test_a_silent_connection_is_left_and_nothing_is_lost(self) -> None:
        relay = Relay(self.network.facts["address"])
        stored = self.context()
        through = replace(stored, nodes=(relay.address, self.network.facts["address"]), known=Known(), home=None)
        with ledgerd.connect(through, deadline=30) as reader, ledgerd.connect("Salma", home=self.network.home) as robot:
            self.assertEqual(reader.node, relay.address)
            with robot.acquire(SERVICE, wait=PATIENCE) as grant, reader.subscribe(SERVICE) as stream:
                for number in range(20):
                    if number == 10:
                        relay.silent.set()
                    grant.publish(numbered(number), ttl=30)
                self.assertEqual([number_of(next(stream).payload) for _ in range(20)], list(range(20)))
                self.assertEqual(reader.node, self.network.facts["address"])
        relay.close()

    def test_a_node_that_withholds_what_it_should_tell_is_left_though_its_connection_lives(self) -> None:
        class Withholding(Link):
            def __init__(self, address: str, tells: bool) -> None:
                self.address, self.tells, self.fault = address, tells, None
                self.subscribe: Any = lambda request: self

            async def read(self) -> api.Delivery:
                if not self.tells:
                    await asyncio.Event().wait()
                return api.Delivery(height=7)

            def cancel(self) -> None:
                pass

        class Nodes:
            def __init__(self) -> None:
                self.links = [Withholding("a:1", False), Withholding("b:1", True)]

            async def up(self) -> Link:
                return self.links[0]

            def leave(self, link: Link) -> None:
                self.links.remove(link)  # type: ignore[arg-type]

            def see(self, height: int) -> None:
                pass

        nodes: Any = Nodes()
        with mock.patch.object(events, "_ACCEPT_MAX", 0.05):
            delivery = asyncio.run(Deliveries(nodes, Wanted(from_height=7)).next())
        self.assertEqual((delivery.height, [link.address for link in nodes.links]), (7, ["b:1"]))

    def test_a_call_through_a_silent_connection_is_executed_once(self) -> None:
        relay = Relay(self.network.facts["address"])
        through = replace(self.context(), nodes=(relay.address, self.network.facts["address"]), known=Known(), home=None)
        with ledgerd.connect(through, deadline=30) as robot, robot.acquire(SERVICE, wait=PATIENCE, lease=60) as grant:
            relay.silent.set()
            published = grant.publish(TWIST, ttl=30)
            with robot.subscribe(SERVICE, from_height=published.height) as stream:
                self.assertEqual(next(stream).transaction, published.transaction)
        relay.close()

    def test_questions_calls_and_streams_outlive_the_end_of_their_connection(self) -> None:
        async def run() -> None:
            async with await ledgerd.aio.connect("Salma", home=self.network.home) as robot:
                async with robot.acquire(SERVICE, wait=PATIENCE, lease=60) as grant:
                    stream = await robot.subscribe(SERVICE)
                    heard = asyncio.ensure_future(anext(stream))
                    for number in range(10):
                        asked = asyncio.gather(*(robot.robots() for _ in range(5)), robot.status())
                        sent = asyncio.ensure_future(grant.publish(numbered(number), ttl=30))
                        await asyncio.sleep(0.001 * number)
                        robot._session._unwanted.set()
                        self.assertEqual(len(await asked), 6)
                        await sent
                        self.assertEqual(number_of((await heard).payload), number)
                        heard = asyncio.ensure_future(anext(stream))
                    heard.cancel()
                    await stream.aclose()

        asyncio.run(run())

    def test_a_stream_that_breaks_in_any_way_is_no_reason_to_give_up(self) -> None:
        for code in ("UNAVAILABLE", "INTERNAL", "UNKNOWN", "CANCELLED", "DATA_LOSS", "ABORTED"):
            found = of_status("a:1", code, "Received RST_STREAM with error code 2", None)
            self.assertEqual((found.name, found.kind), ("UNREACHABLE", ledgerd.Kind.UNREACHABLE), code)
        for details in (b"", b"\xff", b"\x0a"):
            self.assertEqual(of_status("a:1", "INTERNAL", "", details).kind, ledgerd.Kind.UNREACHABLE)

    def test_where_nobody_answers_a_call_ends_at_its_deadline_with_the_reason(self) -> None:
        found = self.refused(replace(self.context(), nodes=("127.0.0.1:1",), known=Known()))
        self.assertEqual((found.name, found.kind), ("UNREACHABLE", ledgerd.Kind.UNREACHABLE))
        self.assertIn("nc -vz 127.0.0.1 1", found.next)
        relay = Relay(self.network.facts["address"])
        through = replace(self.context(), nodes=(relay.address,), known=Known(nodes=()), home=None)
        with ledgerd.connect(through, deadline=2) as robot:
            relay.silent.set()
            relay.node = "127.0.0.1:1"
            robot._client._session.context = through
            with self.assertRaises(ledgerd.Unreachable):
                robot.call("abac", "acquire", SERVICE.encode())
        relay.close()

    def test_an_address_that_is_none_is_refused_before_anything(self) -> None:
        for wrong in ("host", "host:", "host:0", "host:70000", ":7450"):
            self.assertEqual(self.refused(replace(self.context(), nodes=(wrong,), known=Known())).name, "BAD_ARGUMENT", wrong)

    def test_a_node_cannot_invent_change_or_move_a_message(self) -> None:
        with ledgerd.connect("Salma", home=self.network.home) as robot, robot.acquire(SERVICE, wait=PATIENCE) as grant:
            published = grant.publish(TWIST)
            delivery = self.delivery(robot, published.height)
        (event,) = delivery.events
        reader = self.context("Omar")
        (good,) = Senders(reader).messages(delivery, event)
        self.assertEqual((good.sender, good.payload), ("Org1/Salma", TWIST))

        body = signed.TransactionBody.FromString(signed.Transaction.FromString(event.transaction).body)
        body.args[3] = numbered(7)
        changed = signed.Transaction.FromString(event.transaction)
        changed.body = body.SerializeToString()
        lies: list[tuple[str, dict[str, Any]]] = [
            ("BAD_SIGNATURE", {"transaction": changed.SerializeToString()}),
            ("MALFORMED", {"subject": "Husky/cmd_vel"}),
            ("MALFORMED", {"payload": event.payload.replace(b'"count":1', b'"count":2')}),
            ("MALFORMED", {"payload": event.payload.replace(b'"epoch":', b'"epoch":1')}),
            ("MALFORMED", {"payload": event.payload.replace(b'"first_seq":', b'"first_seq":1')}),
            ("MALFORMED", {"payload": b"[]"}),
            ("MALFORMED", {"transaction": b"\xff"}),
            ("UNKNOWN_CREATOR", {"certificate": b""}),
            ("UNKNOWN_CREATOR", {"certificate": reader.chain[0]}),
        ]
        for name, change in lies:
            lie = api.EventRecord.FromString(event.SerializeToString())
            for field, value in change.items():
                setattr(lie, field, value)
            with self.assertRaises(ledgerd.Refusal, msg=change) as refused:
                Senders(reader).messages(delivery, lie)
            self.assertEqual(refused.exception.name, name, change)
        # A sender of an organisation that the node has made up.
        key = ed25519.Ed25519PrivateKey.generate()
        forged = der(made("Salma", "member", key, (made("ca", "ca", key).subject, key)))
        body.creator = hashlib.sha256(forged).digest()
        raw = body.SerializeToString()
        signature = transaction.sign(key, transaction.PREFIX + raw)
        lie = api.EventRecord.FromString(event.SerializeToString())
        lie.transaction = signed.Transaction(body=raw, signature=signature).SerializeToString()
        lie.certificate = forged
        with self.assertRaises(ledgerd.Denied) as denied:
            Senders(reader).messages(delivery, lie)
        self.assertEqual(denied.exception.name, "UNTRUSTED")

    def delivery(self, robot: ledgerd.Client, height: int) -> api.Delivery:
        async def first() -> api.Delivery:
            deliveries = robot._client.deliveries(Wanted(height, "abac", [SERVICE], ["message"]))
            while True:
                delivery = await deliveries.next()
                if delivery.events:
                    await deliveries.close()
                    return delivery

        return robot._run(first())

    def test_signatures_have_one_form(self) -> None:
        for key in (ed25519.Ed25519PrivateKey.generate(), ec.generate_private_key(ec.SECP256R1())):
            for number in range(40):
                message = number.to_bytes(4, "big")
                signature = transaction.sign(key, message)
                transaction.verify(key.public_key(), signature, message)
                if isinstance(key, ec.EllipticCurvePrivateKey):
                    r, s = utils.decode_dss_signature(signature)
                    self.assertLessEqual(s, transaction.P256_ORDER // 2)
                    high = utils.encode_dss_signature(r, transaction.P256_ORDER - s)
                    with self.assertRaises(ledgerd.Denied):
                        transaction.verify(key.public_key(), high, message)
                with self.assertRaises(ledgerd.Denied):
                    transaction.verify(key.public_key(), signature, message + b"x")
        weak = ed25519.Ed25519PublicKey.from_public_bytes((1).to_bytes(32, "little"))
        with self.assertRaises(ledgerd.Denied):
            transaction.verify(weak, (1).to_bytes(32, "little") + bytes(32), b"any")

    def test_nobody_else_can_speak_through_the_socket_of_a_connection(self) -> None:
        """It is gone as soon as gRPC is connected, and lets no other process in before."""
        # Other processes of this machine have sockets of their own elsewhere.
        with tempfile.TemporaryDirectory() as own, mock.patch("tempfile.tempdir", own):
            with ledgerd.connect("Salma", home=self.network.home) as robot:
                robot.status()
                sockets = Path("/proc/net/unix").read_text().split()
                opened = [path for path in sockets if path.startswith(f"{own}/ledgerd-") and Path(path).exists()]
                self.assertEqual(opened, [])
        code = "import socket; from ledgerd.link import _is_ours; print(_is_ours(socket.socket(fileno={})))"
        ours, theirs = socket.socketpair()
        self.assertTrue(link._is_ours(ours))
        command = [sys.executable, "-c", code.format(theirs.fileno())]
        done = subprocess.run(command, pass_fds=[theirs.fileno()], capture_output=True, check=True)
        self.assertEqual(done.stdout, b"False\n")
        ours.close()
        theirs.close()

    def test_a_certificate_in_the_last_third_of_its_life_is_renewed(self) -> None:
        stored = self.context(Dev.ADMIN)
        with ledgerd.connect(Dev.ADMIN, home=self.network.home) as admin:
            session = admin._client._session
            first, last = certificate.validity(certificate.parse(stored.chain[0]))
            session._clock += last - (last - first) // 4 - session.now()
            admin._run(renew_if_due(session))
            renewed = self.context(Dev.ADMIN)
            self.assertNotEqual(renewed.chain, stored.chain)
            self.assertEqual((admin.context.chain, renewed.id), (renewed.chain, stored.id))
            admin._run(session.learn_clock())
            self.assertTrue(admin.robots())
        self.network.ctl(Dev.ADMIN, "whoami")
        self.network.ctl(Dev.ADMIN, "identity", "register", "Renewed")

    def test_a_certificate_that_another_program_renewed_is_taken(self) -> None:
        stored = self.context(Dev.OWNER)
        with ledgerd.connect(Dev.OWNER, home=self.network.home) as owner:
            self.network.ctl(Dev.OWNER, "identity", "renew")
            renewed = self.context(Dev.OWNER)
            self.assertNotEqual(renewed.chain, stored.chain)
            session = owner._client._session
            owner._run(at_once(session._unwanted.set))
            eventually("it goes on with the newest", lambda: owner.context.chain == renewed.chain or None)
            owner.stop("Husky")
            owner.resume("Husky")


async def at_once(action: Callable[[], None]) -> None:
    """Does something in the event loop of the client."""
    action()


_SKEWED = f"""
import os, time
skew = int(os.environ["SKEW"])
import ledgerd, ssl
from ledgerd import tls
real = time.time_ns
time.time_ns = lambda: real() + skew * 10**9
if skew > 10**6:
    # What the library says by such a clock.
    def late(address, settings, patience):
        raise tls._not_accepted(address, late.error)
    late.error = ssl.SSLCertVerificationError()
    late.error.verify_code, late.error.verify_message = 10, "certificate has expired"
    honest = tls.connect
    async def connect(address, settings, patience):
        if settings.context.verify_mode == ssl.CERT_REQUIRED:
            late(address, settings, patience)
        return await honest(address, settings, patience)
    tls.connect = connect
try:
    with ledgerd.connect("Salma") as robot, robot.acquire({SERVICE!r}, wait=60) as grant:
        grant.publish(bytes.fromhex("00010000") + bytes(48))
        print("published")
except ledgerd.Refusal as refused:
    print(refused.name, refused.message)
"""


class Liars(unittest.TestCase):
    """A node that tells of blocks that do not exist, in front of an honest network."""

    def test_a_stream_from_the_next_block_of_a_liar_misses_nothing(self) -> None:
        with Dev() as network:
            network.enrol(Dev.ADMIN, "Salma", "Turtlebot4")
            with ledgerd.connect("Salma", home=network.home) as robot, robot.acquire(SERVICE, lease=60) as grant:

                async def lie(link: Link) -> tuple[str, int]:
                    return "127.0.0.1:1", 1 << 40

                with mock.patch.object(events, "_height", lie):
                    stream = robot.subscribe(SERVICE)
                self.assertEqual(stream.next_height, (1 << 40) + 1)
                grant.publish(numbered(4))
                heard: list[int] = []
                listener = threading.Thread(target=lambda: heard.extend(number_of(next(stream).payload) for _ in range(2)))
                listener.start()
                eventually("the lie is found out", lambda: stream.next_height < 1 << 40 or None)
                grant.publish(numbered(5))
                listener.join()
                self.assertEqual(heard, [4, 5])

    def test_a_stream_outlives_a_node_that_told_of_blocks_that_do_not_exist(self) -> None:
        with Three() as network:
            network.enrol("admin", "Salma", "Turtlebot4")
            with ledgerd.connect("Salma", home=network.home) as robot, robot.acquire(SERVICE, lease=300) as grant:
                first = grant.publish(numbered(0))
                with robot.subscribe(SERVICE, from_height=first.height) as stream:
                    self.assertEqual(number_of(next(stream).payload), 0)
                    # What is known of heights is changed as a liar's word would change it.
                    source: Any = stream._source
                    session = robot._client._session
                    robot._run(at_once(lambda: source._deliveries._accept(api.Delivery(height=1 << 40), "127.0.0.1:1")))
                    self.assertEqual((stream.next_height, session.seen), ((1 << 40) + 1, 1 << 40))
                    robot._run(at_once(session._unwanted.set))
                    for number in range(1, 6):
                        grant.publish(numbered(number), ttl=60)
                    seen = [number_of(next(stream).payload) for _ in range(5)]
                    self.assertEqual(seen, [1, 2, 3, 4, 5])


if __name__ == "__main__":
    unittest.main()
