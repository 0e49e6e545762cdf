"""Prints the tokens of a graph, and one message: listen.py ENDPOINT DOMAIN."""

import json
import queue
import sys

import zenoh

endpoint, domain = sys.argv[1:]
config = zenoh.Config()
config.insert_json5("mode", '"client"')
config.insert_json5("connect/endpoints", json.dumps([endpoint]))
config.insert_json5("scouting/multicast/enabled", "false")
with zenoh.open(config) as session:
    heard = queue.Queue()
    subscriber = session.declare_subscriber(f"{domain}/**", lambda sample: heard.put(sample))
    tokens = sorted(str(reply.ok.key_expr) for reply in session.liveliness().get(f"@ros2_lv/{domain}/**"))
    # The number of the node before that of the publisher. The router is a node, too.
    print("\n".join(token for token in tokens if "/bridge" in token))
    kind = "geometry_msgs::msg::dds_::Vector3_/TypeHashNotSupported/::,10:,:,:,,"
    token = session.liveliness().declare_token(f"@ros2_lv/{domain}/{session.info.zid()}/0/1/MS/%/%/listener/%listener/{kind}")
    sample = heard.get(timeout=20)
    print(sample.key_expr)
    print(sample.payload.to_bytes().hex())
    print(sample.attachment.to_bytes().hex())
