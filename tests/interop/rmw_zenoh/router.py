"""The router of a graph of rmw_zenoh: prints "ready", and runs until it is ended."""

import time

from graph import session

with session("router"):
    print("ready", flush=True)
    while True:
        time.sleep(3600)
