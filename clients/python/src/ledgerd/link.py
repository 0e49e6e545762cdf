"""One connection to a node, with gRPC on it.

gRPC connects to a socket in a directory of our own, and this module carries the bytes between that socket and TLS. The
socket takes one connection of this very process and is gone then: nobody else can speak as us through it. Like the TLS
connection, the channel is never made anew; the session opens another link instead.
"""

from __future__ import annotations

import asyncio
import contextlib
import os
import shutil
import socket
import struct
import tempfile
from collections.abc import Awaitable
from pathlib import Path
from typing import Final, TypeVar

import grpc
import grpc.aio
from google.protobuf.message import Message

from ledgerd import tls
from ledgerd.process import check_fork
from ledgerd.refusal import Refusal, of_status
from ledgerd.tls import Settings, unreachable
from ledgerd.v1 import enrolment_pb2 as enrolment
from ledgerd.v1 import gateway_pb2 as api

_CHUNK: Final = 256 * 1024
_MESSAGE_BYTES_MAX: Final = 32 * 1024 * 1024
# A name of a socket may have 108 bytes with the zero at its end.
_SOCKET_PATH_BYTES_MAX: Final = 107

_OPTIONS: Final = [
    ("grpc.max_receive_message_length", _MESSAGE_BYTES_MAX),
    ("grpc.max_send_message_length", _MESSAGE_BYTES_MAX),
    ("grpc.enable_retries", 0),
    # A node that was stopped answers to no ping.
    ("grpc.keepalive_time_ms", 1_000),
    ("grpc.keepalive_timeout_ms", 1_500),
    ("grpc.keepalive_permit_without_calls", 1),
    ("grpc.http2.max_pings_without_data", 0),
    # Channels of the same target must not share a connection.
    ("grpc.use_local_subchannel_pool", 1),
    ("grpc.enable_http_proxy", 0),
]

Request = TypeVar("Request", bound=Message)
Response = TypeVar("Response", bound=Message)
Answer = TypeVar("Answer")


class Link:
    """An open connection. Close it."""

    def __init__(self, address: str, channel: grpc.aio.Channel) -> None:
        self.address = address
        self._channel = channel
        self._carrier: asyncio.Task[None] | None = None
        self.fault: Refusal | None = None
        unary, stream = channel.unary_unary, channel.unary_stream
        gateway, enroller = "/ledgerd.v1.Gateway/", "/ledgerd.v1.Enrolment/"
        self.submit_stream: grpc.aio.StreamStreamMultiCallable[api.SubmitRequest, api.SubmitResponse] = channel.stream_stream(
            gateway + "SubmitStream",
            request_serializer=api.SubmitRequest.SerializeToString,
            response_deserializer=api.SubmitResponse.FromString,
        )
        self.subscribe: grpc.aio.UnaryStreamMultiCallable[api.SubscribeRequest, api.Delivery] = stream(
            gateway + "Subscribe",
            request_serializer=api.SubscribeRequest.SerializeToString,
            response_deserializer=api.Delivery.FromString,
        )
        self.query: grpc.aio.UnaryUnaryMultiCallable[api.QueryRequest, api.QueryResponse] = unary(
            gateway + "Query",
            request_serializer=api.QueryRequest.SerializeToString,
            response_deserializer=api.QueryResponse.FromString,
        )
        self.status: grpc.aio.UnaryUnaryMultiCallable[api.StatusRequest, api.StatusResponse] = unary(
            gateway + "Status",
            request_serializer=api.StatusRequest.SerializeToString,
            response_deserializer=api.StatusResponse.FromString,
        )
        self.get_block: grpc.aio.UnaryUnaryMultiCallable[api.GetBlockRequest, api.Block] = unary(
            gateway + "GetBlock",
            request_serializer=api.GetBlockRequest.SerializeToString,
            response_deserializer=api.Block.FromString,
        )
        self.get_transaction: grpc.aio.UnaryUnaryMultiCallable[api.GetTransactionRequest, api.TransactionRecord] = unary(
            gateway + "GetTransaction",
            request_serializer=api.GetTransactionRequest.SerializeToString,
            response_deserializer=api.TransactionRecord.FromString,
        )
        self.network: grpc.aio.UnaryUnaryMultiCallable[enrolment.NetworkRequest, enrolment.NetworkResponse] = unary(
            enroller + "Network",
            request_serializer=enrolment.NetworkRequest.SerializeToString,
            response_deserializer=enrolment.NetworkResponse.FromString,
        )
        self.enrol: grpc.aio.UnaryUnaryMultiCallable[enrolment.EnrolRequest, enrolment.EnrolResponse] = unary(
            enroller + "Enrol",
            request_serializer=enrolment.EnrolRequest.SerializeToString,
            response_deserializer=enrolment.EnrolResponse.FromString,
        )
        self.renew: grpc.aio.UnaryUnaryMultiCallable[enrolment.RenewRequest, enrolment.EnrolResponse] = unary(
            enroller + "Renew",
            request_serializer=enrolment.RenewRequest.SerializeToString,
            response_deserializer=enrolment.EnrolResponse.FromString,
        )

    @classmethod
    async def open(cls, address: str, settings: Settings, patience: float) -> Link:
        """Connects to a node within so many seconds."""
        check_fork()
        reader, writer = await tls.connect(address, settings, patience)
        arrived: asyncio.Queue[tuple[asyncio.StreamReader, asyncio.StreamWriter]] = asyncio.Queue()
        try:
            server, directory = await _listen(arrived)
        except BaseException:
            writer.close()
            raise
        channel = grpc.aio.insecure_channel(f"unix:{directory / 's'}", options=[*_OPTIONS, ("grpc.default_authority", "node")])
        link = cls(address, channel)
        link._carrier = asyncio.create_task(link._carry(server, directory, arrived, reader, writer))
        ready = asyncio.create_task(channel.channel_ready())
        try:
            await asyncio.wait({ready, link._carrier}, timeout=patience, return_when=asyncio.FIRST_COMPLETED)
            if not ready.done():
                raise link.fault or unreachable(address, f"no HTTP/2 within {patience:g} s")
        except BaseException:
            await link.close()
            raise
        finally:
            ready.cancel()
        return link

    async def _carry(
        self,
        server: asyncio.AbstractServer,
        directory: Path,
        arrived: asyncio.Queue[tuple[asyncio.StreamReader, asyncio.StreamWriter]],
        reader: asyncio.StreamReader,
        writer: asyncio.StreamWriter,
    ) -> None:
        """Carries bytes both ways until one end is closed."""
        local: asyncio.StreamWriter | None = None
        try:
            try:
                local_reader, local = await self._ours(arrived)
            finally:
                server.close()
                shutil.rmtree(directory, ignore_errors=True)
            ways = [asyncio.create_task(_pump(*way)) for way in ((reader, local), (local_reader, writer))]
            try:
                done, _ = await asyncio.wait(ways, return_when=asyncio.FIRST_COMPLETED)
                for way in done:
                    self._note(way.exception())
            finally:
                for way in ways:
                    way.cancel()
                await asyncio.gather(*ways, return_exceptions=True)
        finally:
            writer.close()
            if local is not None:
                local.close()

    async def _ours(
        self, arrived: asyncio.Queue[tuple[asyncio.StreamReader, asyncio.StreamWriter]]
    ) -> tuple[asyncio.StreamReader, asyncio.StreamWriter]:
        while True:
            reader, writer = await arrived.get()
            if _is_ours(writer.get_extra_info("socket")):
                return reader, writer
            writer.close()

    def _note(self, error: BaseException | None) -> None:
        if isinstance(error, OSError):
            self.fault = tls.ended(self.address, error)

    async def ask(
        self, method: grpc.aio.UnaryUnaryMultiCallable[Request, Response], request: Request, patience: float
    ) -> Response:
        """Calls a method and waits for its answer at most so many seconds."""
        try:
            return await self.settled(method(request, timeout=patience), None)
        except grpc.aio.AioRpcError as error:
            raise self.refusal(error) from error
        except grpc.aio.UsageError as error:
            raise self._closed() from error

    async def settled(self, what: Awaitable[Answer], patience: float | None) -> Answer:
        """Waits for a part of a call; raises TimeoutError after so many seconds. gRPC cancels what is under way when the
        connection is closed, and that must not look as if the one who waits were cancelled.
        """
        task = asyncio.ensure_future(what)
        try:
            await asyncio.wait({task}, timeout=patience)
            if not task.done():
                raise TimeoutError
            if task.cancelled():
                raise self.fault or self._closed()
            return task.result()
        finally:
            task.cancel()

    def _closed(self) -> Refusal:
        return unreachable(self.address, "the connection is closed")

    def refusal(self, error: grpc.aio.AioRpcError) -> Refusal:
        """Why a call failed. A node that refuses our certificate says so only with how the connection ends."""
        trailing = error.trailing_metadata() or ()
        details = next((value for key, value in trailing if key == "grpc-status-details-bin"), None)
        if details is None and self.fault is not None:
            return self.fault
        raw = details if isinstance(details, bytes) else None
        return of_status(self.address, error.code().name, error.details() or "", raw)

    async def close(self) -> None:
        """Ends the connection and everything on it."""
        with contextlib.suppress(Exception):
            await self._channel.close()
        if self._carrier is not None:
            self._carrier.cancel()
            await asyncio.gather(self._carrier, return_exceptions=True)


async def _pump(source: asyncio.StreamReader, sink: asyncio.StreamWriter) -> None:
    while chunk := await source.read(_CHUNK):
        sink.write(chunk)
        await sink.drain()


async def _listen(
    arrived: asyncio.Queue[tuple[asyncio.StreamReader, asyncio.StreamWriter]],
) -> tuple[asyncio.AbstractServer, Path]:
    """A socket in a directory of our own, and that directory."""
    try:
        directory = _own_directory()
        try:
            path = str(directory / "s")
            server = await asyncio.start_unix_server(lambda *both: arrived.put_nowait(both), path, limit=_CHUNK)
        except BaseException:
            shutil.rmtree(directory, ignore_errors=True)
            raise
    except OSError as error:
        raise tls.short_of_means(error) from error
    return server, directory


def _own_directory() -> Path:
    """A directory that only we may enter, whose name is short enough for a socket in it."""
    made = Path(tempfile.mkdtemp(prefix="ledgerd-"))
    if len(os.fsencode(made / "s")) <= _SOCKET_PATH_BYTES_MAX:
        return made
    made.rmdir()
    return Path(tempfile.mkdtemp(prefix="ledgerd-", dir="/tmp"))


def _is_ours(accepted: socket.socket) -> bool:
    """Did this very process connect? Where the system cannot tell, the directory keeps others out."""
    if not hasattr(socket, "SO_PEERCRED"):
        return True
    credentials = accepted.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, struct.calcsize("3i"))
    process: int = struct.unpack("3i", credentials)[0]
    return process == os.getpid()
