"""Calls that a node refuses, made with grpcio. Prints what a program in Python finds in each refusal, one JSON object per
line.

    refusals.py CONTEXT SERVICE

CONTEXT is the directory of a context that may not read SERVICE. The generated code of the proto files and the example client
must be on the path (PYTHONPATH).
"""

import json
import sys
from pathlib import Path

import client as example
import grpc
from google.rpc import error_details_pb2
from grpc_status import rpc_status
from ledgerd.v1 import gateway_pb2 as api
from ledgerd.v1 import gateway_pb2_grpc as services


def refused(what: str, call) -> None:
    """Prints the status of a call that must fail."""
    try:
        call()
    except grpc.RpcError as error:
        line = {"call": what, "grpc": error.code().name, "text": error.details()}
        # It raises if the status in the details is another than the call's.
        status = rpc_status.from_call(error)
        for detail in status.details if status else []:
            info = error_details_pb2.ErrorInfo()
            if detail.Unpack(info):
                line |= {"reason": info.reason, "domain": info.domain, "metadata": dict(info.metadata)}
        print(json.dumps(line))
    else:
        sys.exit(f"{what}: not refused")


def main() -> None:
    context, service = Path(sys.argv[1]), sys.argv[2]
    named = example.Client(context).gateway
    nameless = services.GatewayStub(example.channel(context, None, None))
    refused("block", lambda: named.GetBlock(api.GetBlockRequest(height=1 << 40)))
    refused("no certificate", lambda: nameless.Status(api.StatusRequest()))
    refused("not admin", lambda: named.Denials(api.DenialsRequest()))
    query = api.QueryRequest(chaincode="abac", function="robots", min_height=1 << 40, may_be_stale=True)
    refused("behind", lambda: named.Query(query))
    refused("id", lambda: named.GetTransaction(api.GetTransactionRequest(id=b"no id")))
    request = api.SubscribeRequest(chaincode="abac", subjects=[service], names=["message"])
    refused("subscription", lambda: next(named.Subscribe(request)))


if __name__ == "__main__":
    main()
