from ledgerd.v1 import gateway_pb2 as _gateway_pb2
from google.protobuf.internal import containers as _containers
from google.protobuf import descriptor as _descriptor
from google.protobuf import message as _message
from collections.abc import Iterable as _Iterable, Mapping as _Mapping
from typing import ClassVar as _ClassVar, Optional as _Optional, Union as _Union

DESCRIPTOR: _descriptor.FileDescriptor

class RenewRequest(_message.Message):
    __slots__ = ("request",)
    REQUEST_FIELD_NUMBER: _ClassVar[int]
    request: bytes
    def __init__(self, request: _Optional[bytes] = ...) -> None: ...

class GenesisRequest(_message.Message):
    __slots__ = ()
    def __init__(self) -> None: ...

class GenesisResponse(_message.Message):
    __slots__ = ("genesis",)
    GENESIS_FIELD_NUMBER: _ClassVar[int]
    genesis: bytes
    def __init__(self, genesis: _Optional[bytes] = ...) -> None: ...

class JoinOrganisationRequest(_message.Message):
    __slots__ = ("join",)
    JOIN_FIELD_NUMBER: _ClassVar[int]
    join: bytes
    def __init__(self, join: _Optional[bytes] = ...) -> None: ...

class JoinOrganisationResponse(_message.Message):
    __slots__ = ("verdict",)
    VERDICT_FIELD_NUMBER: _ClassVar[int]
    verdict: _gateway_pb2.Verdict
    def __init__(self, verdict: _Optional[_Union[_gateway_pb2.Verdict, _Mapping]] = ...) -> None: ...

class NetworkRequest(_message.Message):
    __slots__ = ()
    def __init__(self) -> None: ...

class NetworkResponse(_message.Message):
    __slots__ = ("network", "label", "organisations", "clock", "cut_off", "carries", "rules", "height", "block_hash")
    NETWORK_FIELD_NUMBER: _ClassVar[int]
    LABEL_FIELD_NUMBER: _ClassVar[int]
    ORGANISATIONS_FIELD_NUMBER: _ClassVar[int]
    CLOCK_FIELD_NUMBER: _ClassVar[int]
    CUT_OFF_FIELD_NUMBER: _ClassVar[int]
    CARRIES_FIELD_NUMBER: _ClassVar[int]
    RULES_FIELD_NUMBER: _ClassVar[int]
    HEIGHT_FIELD_NUMBER: _ClassVar[int]
    BLOCK_HASH_FIELD_NUMBER: _ClassVar[int]
    network: bytes
    label: str
    organisations: _containers.RepeatedCompositeFieldContainer[Organisation]
    clock: int
    cut_off: bool
    carries: _containers.RepeatedScalarFieldContainer[str]
    rules: int
    height: int
    block_hash: bytes
    def __init__(self, network: _Optional[bytes] = ..., label: _Optional[str] = ..., organisations: _Optional[_Iterable[_Union[Organisation, _Mapping]]] = ..., clock: _Optional[int] = ..., cut_off: _Optional[bool] = ..., carries: _Optional[_Iterable[str]] = ..., rules: _Optional[int] = ..., height: _Optional[int] = ..., block_hash: _Optional[bytes] = ...) -> None: ...

class Organisation(_message.Message):
    __slots__ = ("name", "roots", "intermediates", "addresses", "units")
    NAME_FIELD_NUMBER: _ClassVar[int]
    ROOTS_FIELD_NUMBER: _ClassVar[int]
    INTERMEDIATES_FIELD_NUMBER: _ClassVar[int]
    ADDRESSES_FIELD_NUMBER: _ClassVar[int]
    UNITS_FIELD_NUMBER: _ClassVar[int]
    name: str
    roots: _containers.RepeatedScalarFieldContainer[bytes]
    intermediates: _containers.RepeatedScalarFieldContainer[bytes]
    addresses: _containers.RepeatedScalarFieldContainer[str]
    units: Units
    def __init__(self, name: _Optional[str] = ..., roots: _Optional[_Iterable[bytes]] = ..., intermediates: _Optional[_Iterable[bytes]] = ..., addresses: _Optional[_Iterable[str]] = ..., units: _Optional[_Union[Units, _Mapping]] = ...) -> None: ...

class Units(_message.Message):
    __slots__ = ("units",)
    UNITS_FIELD_NUMBER: _ClassVar[int]
    units: _containers.RepeatedCompositeFieldContainer[Unit]
    def __init__(self, units: _Optional[_Iterable[_Union[Unit, _Mapping]]] = ...) -> None: ...

class Unit(_message.Message):
    __slots__ = ("unit", "role", "issuer")
    UNIT_FIELD_NUMBER: _ClassVar[int]
    ROLE_FIELD_NUMBER: _ClassVar[int]
    ISSUER_FIELD_NUMBER: _ClassVar[int]
    unit: str
    role: str
    issuer: bytes
    def __init__(self, unit: _Optional[str] = ..., role: _Optional[str] = ..., issuer: _Optional[bytes] = ...) -> None: ...

class EnrolRequest(_message.Message):
    __slots__ = ("name", "secret", "request")
    NAME_FIELD_NUMBER: _ClassVar[int]
    SECRET_FIELD_NUMBER: _ClassVar[int]
    REQUEST_FIELD_NUMBER: _ClassVar[int]
    name: str
    secret: str
    request: bytes
    def __init__(self, name: _Optional[str] = ..., secret: _Optional[str] = ..., request: _Optional[bytes] = ...) -> None: ...

class EnrolResponse(_message.Message):
    __slots__ = ("verdict", "certificate", "chain", "organisation", "network", "carriers")
    VERDICT_FIELD_NUMBER: _ClassVar[int]
    CERTIFICATE_FIELD_NUMBER: _ClassVar[int]
    CHAIN_FIELD_NUMBER: _ClassVar[int]
    ORGANISATION_FIELD_NUMBER: _ClassVar[int]
    NETWORK_FIELD_NUMBER: _ClassVar[int]
    CARRIERS_FIELD_NUMBER: _ClassVar[int]
    verdict: _gateway_pb2.Verdict
    certificate: bytes
    chain: _containers.RepeatedScalarFieldContainer[bytes]
    organisation: str
    network: NetworkResponse
    carriers: _containers.RepeatedScalarFieldContainer[str]
    def __init__(self, verdict: _Optional[_Union[_gateway_pb2.Verdict, _Mapping]] = ..., certificate: _Optional[bytes] = ..., chain: _Optional[_Iterable[bytes]] = ..., organisation: _Optional[str] = ..., network: _Optional[_Union[NetworkResponse, _Mapping]] = ..., carriers: _Optional[_Iterable[str]] = ...) -> None: ...

class OfferCaRequest(_message.Message):
    __slots__ = ("organisation",)
    ORGANISATION_FIELD_NUMBER: _ClassVar[int]
    organisation: str
    def __init__(self, organisation: _Optional[str] = ...) -> None: ...

class OfferCaResponse(_message.Message):
    __slots__ = ("verdict", "node", "key", "signature", "certificate")
    VERDICT_FIELD_NUMBER: _ClassVar[int]
    NODE_FIELD_NUMBER: _ClassVar[int]
    KEY_FIELD_NUMBER: _ClassVar[int]
    SIGNATURE_FIELD_NUMBER: _ClassVar[int]
    CERTIFICATE_FIELD_NUMBER: _ClassVar[int]
    verdict: _gateway_pb2.Verdict
    node: str
    key: bytes
    signature: bytes
    certificate: bytes
    def __init__(self, verdict: _Optional[_Union[_gateway_pb2.Verdict, _Mapping]] = ..., node: _Optional[str] = ..., key: _Optional[bytes] = ..., signature: _Optional[bytes] = ..., certificate: _Optional[bytes] = ...) -> None: ...

class SealCaRequest(_message.Message):
    __slots__ = ("organisation", "node", "key", "signature", "certificate")
    ORGANISATION_FIELD_NUMBER: _ClassVar[int]
    NODE_FIELD_NUMBER: _ClassVar[int]
    KEY_FIELD_NUMBER: _ClassVar[int]
    SIGNATURE_FIELD_NUMBER: _ClassVar[int]
    CERTIFICATE_FIELD_NUMBER: _ClassVar[int]
    organisation: str
    node: str
    key: bytes
    signature: bytes
    certificate: bytes
    def __init__(self, organisation: _Optional[str] = ..., node: _Optional[str] = ..., key: _Optional[bytes] = ..., signature: _Optional[bytes] = ..., certificate: _Optional[bytes] = ...) -> None: ...

class SealCaResponse(_message.Message):
    __slots__ = ("verdict", "sealed", "root")
    VERDICT_FIELD_NUMBER: _ClassVar[int]
    SEALED_FIELD_NUMBER: _ClassVar[int]
    ROOT_FIELD_NUMBER: _ClassVar[int]
    verdict: _gateway_pb2.Verdict
    sealed: bytes
    root: bytes
    def __init__(self, verdict: _Optional[_Union[_gateway_pb2.Verdict, _Mapping]] = ..., sealed: _Optional[bytes] = ..., root: _Optional[bytes] = ...) -> None: ...

class TakeCaRequest(_message.Message):
    __slots__ = ("organisation", "sealed", "root")
    ORGANISATION_FIELD_NUMBER: _ClassVar[int]
    SEALED_FIELD_NUMBER: _ClassVar[int]
    ROOT_FIELD_NUMBER: _ClassVar[int]
    organisation: str
    sealed: bytes
    root: bytes
    def __init__(self, organisation: _Optional[str] = ..., sealed: _Optional[bytes] = ..., root: _Optional[bytes] = ...) -> None: ...

class TakeCaResponse(_message.Message):
    __slots__ = ("verdict",)
    VERDICT_FIELD_NUMBER: _ClassVar[int]
    verdict: _gateway_pb2.Verdict
    def __init__(self, verdict: _Optional[_Union[_gateway_pb2.Verdict, _Mapping]] = ...) -> None: ...

class CopyCaRequest(_message.Message):
    __slots__ = ("organisation", "passphrase")
    ORGANISATION_FIELD_NUMBER: _ClassVar[int]
    PASSPHRASE_FIELD_NUMBER: _ClassVar[int]
    organisation: str
    passphrase: str
    def __init__(self, organisation: _Optional[str] = ..., passphrase: _Optional[str] = ...) -> None: ...

class CopyCaResponse(_message.Message):
    __slots__ = ("verdict", "file")
    VERDICT_FIELD_NUMBER: _ClassVar[int]
    FILE_FIELD_NUMBER: _ClassVar[int]
    verdict: _gateway_pb2.Verdict
    file: bytes
    def __init__(self, verdict: _Optional[_Union[_gateway_pb2.Verdict, _Mapping]] = ..., file: _Optional[bytes] = ...) -> None: ...

class RestoreCaRequest(_message.Message):
    __slots__ = ("organisation", "file", "passphrase")
    ORGANISATION_FIELD_NUMBER: _ClassVar[int]
    FILE_FIELD_NUMBER: _ClassVar[int]
    PASSPHRASE_FIELD_NUMBER: _ClassVar[int]
    organisation: str
    file: bytes
    passphrase: str
    def __init__(self, organisation: _Optional[str] = ..., file: _Optional[bytes] = ..., passphrase: _Optional[str] = ...) -> None: ...

class RestoreCaResponse(_message.Message):
    __slots__ = ("verdict",)
    VERDICT_FIELD_NUMBER: _ClassVar[int]
    verdict: _gateway_pb2.Verdict
    def __init__(self, verdict: _Optional[_Union[_gateway_pb2.Verdict, _Mapping]] = ...) -> None: ...

class DropCaRequest(_message.Message):
    __slots__ = ("organisation",)
    ORGANISATION_FIELD_NUMBER: _ClassVar[int]
    organisation: str
    def __init__(self, organisation: _Optional[str] = ...) -> None: ...

class DropCaResponse(_message.Message):
    __slots__ = ("verdict",)
    VERDICT_FIELD_NUMBER: _ClassVar[int]
    verdict: _gateway_pb2.Verdict
    def __init__(self, verdict: _Optional[_Union[_gateway_pb2.Verdict, _Mapping]] = ...) -> None: ...
