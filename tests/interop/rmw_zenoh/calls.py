"""As ../calls.py, in a graph of rmw_zenoh.

calls.py serve DOMAIN NAME KIND [silent]       prints each request; replies with what came, unless it is silent
calls.py call DOMAIN NAME KIND WAIT_S VALUE…   calls once for each value, prints each reply, or "none" after the wait
"""

import queue
import sys
import time

from graph import Node, Reader, Writer, reply

role, domain, name, kind = sys.argv[1], int(sys.argv[2]), sys.argv[3], sys.argv[4]
words = sys.argv[5:]
node, of = Node(domain, f"calls_{role}"), f"std_srvs::srv::dds_::{kind}_"

if role == "serve":
    requests = node.server(name, of)
    print("ready", flush=True)
    kept = []
    while True:
        query = requests.get()
        value = bool(Reader(query.payload.to_bytes()).get("B"))
        print(f"request {value}", flush=True)
        if "silent" in words:
            kept.append(query)
        else:
            reply(query, Writer().put("?", value).text(f"from {name}").done())

call, replies = node.client(name, of)
print("matched", flush=True)
patience = float(words[0])
for value in words[1:]:
    number = call(Writer().put("B", value == "true" if kind == "SetBool" else int(value)).done())
    deadline, line = time.monotonic() + patience, "none"
    while line == "none" and time.monotonic() < deadline:
        try:
            of_number, payload = replies.get(timeout=0.05)
        except queue.Empty:
            continue
        if of_number == number:
            answer = Reader(payload)
            success = bool(answer.get("B"))
            line = f"{success} {answer.text()}".replace("\n", " | ")
    print(line, flush=True)
node.leave()
