from google.protobuf.internal import containers as _containers
from google.protobuf import descriptor as _descriptor
from google.protobuf import message as _message
from collections.abc import Iterable as _Iterable, Mapping as _Mapping
from typing import ClassVar as _ClassVar, Optional as _Optional, Union as _Union

DESCRIPTOR: _descriptor.FileDescriptor

class Transaction(_message.Message):
    __slots__ = ("body", "signature", "certificate")
    BODY_FIELD_NUMBER: _ClassVar[int]
    SIGNATURE_FIELD_NUMBER: _ClassVar[int]
    CERTIFICATE_FIELD_NUMBER: _ClassVar[int]
    body: bytes
    signature: bytes
    certificate: bytes
    def __init__(self, body: _Optional[bytes] = ..., signature: _Optional[bytes] = ..., certificate: _Optional[bytes] = ...) -> None: ...

class TransactionBody(_message.Message):
    __slots__ = ("network", "creator", "nonce", "not_after", "chaincode", "function", "args", "known_block")
    NETWORK_FIELD_NUMBER: _ClassVar[int]
    CREATOR_FIELD_NUMBER: _ClassVar[int]
    NONCE_FIELD_NUMBER: _ClassVar[int]
    NOT_AFTER_FIELD_NUMBER: _ClassVar[int]
    CHAINCODE_FIELD_NUMBER: _ClassVar[int]
    FUNCTION_FIELD_NUMBER: _ClassVar[int]
    ARGS_FIELD_NUMBER: _ClassVar[int]
    KNOWN_BLOCK_FIELD_NUMBER: _ClassVar[int]
    network: bytes
    creator: bytes
    nonce: bytes
    not_after: int
    chaincode: str
    function: str
    args: _containers.RepeatedScalarFieldContainer[bytes]
    known_block: KnownBlock
    def __init__(self, network: _Optional[bytes] = ..., creator: _Optional[bytes] = ..., nonce: _Optional[bytes] = ..., not_after: _Optional[int] = ..., chaincode: _Optional[str] = ..., function: _Optional[str] = ..., args: _Optional[_Iterable[bytes]] = ..., known_block: _Optional[_Union[KnownBlock, _Mapping]] = ...) -> None: ...

class KnownBlock(_message.Message):
    __slots__ = ("height", "hash", "known_us")
    HEIGHT_FIELD_NUMBER: _ClassVar[int]
    HASH_FIELD_NUMBER: _ClassVar[int]
    KNOWN_US_FIELD_NUMBER: _ClassVar[int]
    height: int
    hash: bytes
    known_us: int
    def __init__(self, height: _Optional[int] = ..., hash: _Optional[bytes] = ..., known_us: _Optional[int] = ...) -> None: ...
