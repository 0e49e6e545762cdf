"""A node in a graph of rmw_zenoh, over plain zenoh: keys, tokens, attachments, and CDR. Services and topics are bytes here."""

import json
import os
import queue
import struct
import sys
import time

import xxhash
import zenoh

ROUTER = "tcp/127.0.0.1:7447"
NO_HASH = "TypeHashNotSupported"


def session(mode="client"):
    """A session with the router; it waits for it."""
    config = zenoh.Config()
    config.insert_json5("mode", json.dumps(mode))
    config.insert_json5("scouting/multicast/enabled", "false")
    config.insert_json5("timestamping/enabled", "true")
    if mode == "router":
        config.insert_json5("listen/endpoints", json.dumps([ROUTER]))
        return zenoh.open(config)
    config.insert_json5("connect/endpoints", json.dumps([ROUTER]))
    config.insert_json5("listen/endpoints", "[]")
    deadline = time.monotonic() + 20
    while True:
        try:
            return zenoh.open(config)
        except zenoh.ZError:
            if time.monotonic() > deadline:
                raise
            time.sleep(0.05)


def mangle(name):
    return name.replace("/", "%") or "%"


def until(condition, what, seconds=40):
    deadline = time.monotonic() + seconds
    while not condition():
        if time.monotonic() > deadline:
            sys.exit(f"{what} within {seconds} s")
        time.sleep(0.005)


class Node:
    def __init__(self, domain, name):
        self.session, self.domain, self.name, self.count = session(), domain, name, 0
        self.zid = str(self.session.info.zid())
        self.others, self.held = {}, []
        self.held.append(
            self.session.liveliness().declare_subscriber(f"@ros2_lv/{domain}/**", self.note, history=True)
        )
        self.held.append(self.session.liveliness().declare_token(self.key("NN", 0)))

    def leave(self, code=0):
        """Ends the process: threads of zenoh would keep it."""
        self.session.close()
        sys.stdout.flush()
        os._exit(code)

    def key(self, kind, number):
        return f"@ros2_lv/{self.domain}/{self.zid}/0/{number}/{kind}/%/%/{self.name}"

    def note(self, sample):
        """A token of another node has come, or has left."""
        parts = str(sample.key_expr).split("/")
        if len(parts) < 13 or parts[2] == self.zid:
            return
        if sample.kind == zenoh.SampleKind.PUT:
            self.others[str(sample.key_expr)] = (parts[5], parts[9], parts[10], parts[11])
        else:
            self.others.pop(str(sample.key_expr), None)

    def there(self, kind, name, type_name):
        """The hashes with which others of this kind are there."""
        found = list(self.others.values())
        return [hash for (of, at, its, hash) in found if (of, at, its) == (kind, mangle(name), type_name)]

    def announce(self, kind, name, type_name, hash=NO_HASH, qos="::,10:,:,:,,"):
        """Declares a token. Answers with the identifier of the endpoint."""
        self.count += 1
        token = f"{self.key(kind, self.count)}/{mangle(name)}/{type_name}/{hash}/{qos}"
        self.held.append(self.session.liveliness().declare_token(token))
        return xxhash.xxh3_128(token.encode()).intdigest().to_bytes(16, "little")

    def topic(self, name, type_name, hash):
        return f"{self.domain}/{name.strip('/')}/{type_name}/{hash}"

    def publisher(self, name, type_name, latched=False):
        """Waits for a subscriber, whose hash it takes over. Answers with a function that publishes."""
        until(lambda: self.there("MS", name, type_name), f"no reader of {name}")
        hash = self.there("MS", name, type_name)[0]
        key = self.topic(name, type_name, hash)
        if latched:
            cache = zenoh.ext.CacheConfig(1)
            publisher = zenoh.ext.declare_advanced_publisher(self.session, key, cache=cache, publisher_detection=True)
        else:
            publisher = self.session.declare_publisher(key)
        gid = self.announce("MP", name, type_name, hash, ":1:,1:,:,:,," if latched else "::,10:,:,:,,")
        self.held.append(publisher)
        sent = 0

        def publish(payload):
            nonlocal sent
            sent += 1
            publisher.put(payload, attachment=attachment(sent, gid))

        return publish

    def subscriber(self, name, type_name, latched=False):
        """A queue of payloads."""
        received, key = queue.Queue(), self.topic(name, type_name, "*")
        take = lambda sample: received.put(sample.payload.to_bytes())
        if latched:
            history = zenoh.ext.HistoryConfig(detect_late_publishers=True, max_samples=1)
            held = zenoh.ext.declare_advanced_subscriber(self.session, key, take, history=history)
        else:
            held = self.session.declare_subscriber(key, take)
        self.held.append(held)
        self.announce("MS", name, type_name, qos=":1:,1:,:,:,," if latched else "::,10:,:,:,,")
        return received

    def server(self, name, type_name):
        """A queue of queries. `reply` answers one."""
        received = queue.Queue()
        self.held.append(self.session.declare_queryable(self.topic(name, type_name, "*"), received.put, complete=True))
        self.announce("SS", name, type_name)
        return received

    def client(self, name, type_name):
        """Waits for a server. Answers with a function that calls it, and with a queue of numbers and payloads."""
        until(lambda: self.there("SS", name, type_name), f"no server of {name}")
        hash = self.there("SS", name, type_name)[0]
        key, gid = self.topic(name, type_name, hash), self.announce("SC", name, type_name, hash)
        received, sent = queue.Queue(), 0

        def call(payload):
            nonlocal sent
            sent += 1
            number = sent

            def take(reply):
                if reply.ok:
                    received.put((number, reply.ok.payload.to_bytes()))

            self.session.get(
                key,
                take,
                payload=payload,
                attachment=attachment(number, gid),
                target=zenoh.QueryTarget.ALL_COMPLETE,
                consolidation=zenoh.ConsolidationMode.NONE,
                timeout=600,
            )
            return number

        return call, received


def attachment(number, gid):
    return struct.pack("<qqB", number, time.time_ns(), 16) + gid


def reply(query, payload):
    """Answers a query, with its own number and its client's identifier."""
    number, _, _ = struct.unpack_from("<qqB", query.attachment.to_bytes())
    query.reply(query.key_expr, payload, attachment=attachment(number, query.attachment.to_bytes()[17:33]))
    query.drop()


def taken(received):
    """What waits in a queue."""
    found = []
    while True:
        try:
            found.append(received.get_nowait())
        except queue.Empty:
            return found


class Writer:
    """CDR, little endian, with its encapsulation header."""

    def __init__(self):
        self.body = b""

    def put(self, form, *values):
        for value in values:
            self.body += b"\0" * (-len(self.body) % struct.calcsize(form)) + struct.pack("<" + form, value)
        return self

    def raw(self, data):
        self.body += data
        return self

    def text(self, text):
        data = text.encode() + b"\0"
        return self.put("I", len(data)).raw(data)

    def done(self):
        return b"\0\1\0\0" + self.body


class Reader:
    """The same, read."""

    def __init__(self, payload):
        assert payload[:2] == b"\0\1", payload[:4]
        self.body, self.at = payload[4:], 0

    def get(self, form):
        size = struct.calcsize(form)
        self.at += -self.at % size
        (value,) = struct.unpack_from("<" + form, self.body, self.at)
        self.at += size
        return value

    def raw(self, size):
        self.at += size
        return self.body[self.at - size : self.at]

    def text(self):
        return self.raw(self.get("I"))[:-1].decode()
