"""Drives a robot in a circle, also on after its node was killed and started again: drive.py SERVICE SECONDS"""
import struct, sys, time
import ledgerd

LOST = ("NOT_HOLDER", "STALE_EPOCH")
twist = b"\0\1\0\0" + struct.pack("<6d", 0.1, 0, 0, 0, 0, 0.1)  # CDR, as DDS carries it
service, until = sys.argv[1], time.monotonic() + float(sys.argv[2])
with ledgerd.connect() as robot:
    while time.monotonic() < until:
        with robot.acquire(service, wait=30) as grant:
            while grant.lost is None and time.monotonic() < until:
                try:
                    print("block", grant.publish(twist).height, flush=True)
                except (ledgerd.Expired, ledgerd.Unreachable) as late:
                    print("left out", late.code, flush=True)  # an old command is worth nothing: the next one counts
                except ledgerd.Denied as refused:
                    if refused.name not in LOST:
                        raise
                    break  # its lease has ended meanwhile: acquire again
                time.sleep(0.1)
