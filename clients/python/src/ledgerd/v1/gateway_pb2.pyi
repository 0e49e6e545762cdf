from google.protobuf.internal import containers as _containers
from google.protobuf import descriptor as _descriptor
from google.protobuf import message as _message
from collections.abc import Iterable as _Iterable, Mapping as _Mapping
from typing import ClassVar as _ClassVar, Optional as _Optional, Union as _Union

DESCRIPTOR: _descriptor.FileDescriptor

class Verdict(_message.Message):
    __slots__ = ("code", "message", "found", "wanted", "next")
    CODE_FIELD_NUMBER: _ClassVar[int]
    MESSAGE_FIELD_NUMBER: _ClassVar[int]
    FOUND_FIELD_NUMBER: _ClassVar[int]
    WANTED_FIELD_NUMBER: _ClassVar[int]
    NEXT_FIELD_NUMBER: _ClassVar[int]
    code: int
    message: str
    found: str
    wanted: str
    next: str
    def __init__(self, code: _Optional[int] = ..., message: _Optional[str] = ..., found: _Optional[str] = ..., wanted: _Optional[str] = ..., next: _Optional[str] = ...) -> None: ...

class SubmitRequest(_message.Message):
    __slots__ = ("transaction", "min_height", "first_attempt")
    TRANSACTION_FIELD_NUMBER: _ClassVar[int]
    MIN_HEIGHT_FIELD_NUMBER: _ClassVar[int]
    FIRST_ATTEMPT_FIELD_NUMBER: _ClassVar[int]
    transaction: bytes
    min_height: int
    first_attempt: bool
    def __init__(self, transaction: _Optional[bytes] = ..., min_height: _Optional[int] = ..., first_attempt: _Optional[bool] = ...) -> None: ...

class SubmitResponse(_message.Message):
    __slots__ = ("id", "verdict", "height", "index", "time", "response", "block_hash")
    ID_FIELD_NUMBER: _ClassVar[int]
    VERDICT_FIELD_NUMBER: _ClassVar[int]
    HEIGHT_FIELD_NUMBER: _ClassVar[int]
    INDEX_FIELD_NUMBER: _ClassVar[int]
    TIME_FIELD_NUMBER: _ClassVar[int]
    RESPONSE_FIELD_NUMBER: _ClassVar[int]
    BLOCK_HASH_FIELD_NUMBER: _ClassVar[int]
    id: bytes
    verdict: Verdict
    height: int
    index: int
    time: int
    response: bytes
    block_hash: bytes
    def __init__(self, id: _Optional[bytes] = ..., verdict: _Optional[_Union[Verdict, _Mapping]] = ..., height: _Optional[int] = ..., index: _Optional[int] = ..., time: _Optional[int] = ..., response: _Optional[bytes] = ..., block_hash: _Optional[bytes] = ...) -> None: ...

class QueryRequest(_message.Message):
    __slots__ = ("chaincode", "function", "args", "min_height", "may_be_stale")
    CHAINCODE_FIELD_NUMBER: _ClassVar[int]
    FUNCTION_FIELD_NUMBER: _ClassVar[int]
    ARGS_FIELD_NUMBER: _ClassVar[int]
    MIN_HEIGHT_FIELD_NUMBER: _ClassVar[int]
    MAY_BE_STALE_FIELD_NUMBER: _ClassVar[int]
    chaincode: str
    function: str
    args: _containers.RepeatedScalarFieldContainer[bytes]
    min_height: int
    may_be_stale: bool
    def __init__(self, chaincode: _Optional[str] = ..., function: _Optional[str] = ..., args: _Optional[_Iterable[bytes]] = ..., min_height: _Optional[int] = ..., may_be_stale: _Optional[bool] = ...) -> None: ...

class QueryResponse(_message.Message):
    __slots__ = ("verdict", "response", "height", "time", "stale_for")
    VERDICT_FIELD_NUMBER: _ClassVar[int]
    RESPONSE_FIELD_NUMBER: _ClassVar[int]
    HEIGHT_FIELD_NUMBER: _ClassVar[int]
    TIME_FIELD_NUMBER: _ClassVar[int]
    STALE_FOR_FIELD_NUMBER: _ClassVar[int]
    verdict: Verdict
    response: bytes
    height: int
    time: int
    stale_for: int
    def __init__(self, verdict: _Optional[_Union[Verdict, _Mapping]] = ..., response: _Optional[bytes] = ..., height: _Optional[int] = ..., time: _Optional[int] = ..., stale_for: _Optional[int] = ...) -> None: ...

class SubscribeRequest(_message.Message):
    __slots__ = ("from_height", "chaincode", "subjects", "names", "heartbeat_ms", "early", "proofs", "heads")
    FROM_HEIGHT_FIELD_NUMBER: _ClassVar[int]
    CHAINCODE_FIELD_NUMBER: _ClassVar[int]
    SUBJECTS_FIELD_NUMBER: _ClassVar[int]
    NAMES_FIELD_NUMBER: _ClassVar[int]
    HEARTBEAT_MS_FIELD_NUMBER: _ClassVar[int]
    EARLY_FIELD_NUMBER: _ClassVar[int]
    PROOFS_FIELD_NUMBER: _ClassVar[int]
    HEADS_FIELD_NUMBER: _ClassVar[int]
    from_height: int
    chaincode: str
    subjects: _containers.RepeatedScalarFieldContainer[str]
    names: _containers.RepeatedScalarFieldContainer[str]
    heartbeat_ms: int
    early: bool
    proofs: bool
    heads: bool
    def __init__(self, from_height: _Optional[int] = ..., chaincode: _Optional[str] = ..., subjects: _Optional[_Iterable[str]] = ..., names: _Optional[_Iterable[str]] = ..., heartbeat_ms: _Optional[int] = ..., early: _Optional[bool] = ..., proofs: _Optional[bool] = ..., heads: _Optional[bool] = ...) -> None: ...

class Delivery(_message.Message):
    __slots__ = ("height", "time", "block_hash", "events", "early", "proof", "heads")
    HEIGHT_FIELD_NUMBER: _ClassVar[int]
    TIME_FIELD_NUMBER: _ClassVar[int]
    BLOCK_HASH_FIELD_NUMBER: _ClassVar[int]
    EVENTS_FIELD_NUMBER: _ClassVar[int]
    EARLY_FIELD_NUMBER: _ClassVar[int]
    PROOF_FIELD_NUMBER: _ClassVar[int]
    HEADS_FIELD_NUMBER: _ClassVar[int]
    height: int
    time: int
    block_hash: bytes
    events: _containers.RepeatedCompositeFieldContainer[EventRecord]
    early: bool
    proof: bytes
    heads: bytes
    def __init__(self, height: _Optional[int] = ..., time: _Optional[int] = ..., block_hash: _Optional[bytes] = ..., events: _Optional[_Iterable[_Union[EventRecord, _Mapping]]] = ..., early: _Optional[bool] = ..., proof: _Optional[bytes] = ..., heads: _Optional[bytes] = ...) -> None: ...

class EventRecord(_message.Message):
    __slots__ = ("chaincode", "name", "subject", "payload", "index", "transaction", "certificate")
    CHAINCODE_FIELD_NUMBER: _ClassVar[int]
    NAME_FIELD_NUMBER: _ClassVar[int]
    SUBJECT_FIELD_NUMBER: _ClassVar[int]
    PAYLOAD_FIELD_NUMBER: _ClassVar[int]
    INDEX_FIELD_NUMBER: _ClassVar[int]
    TRANSACTION_FIELD_NUMBER: _ClassVar[int]
    CERTIFICATE_FIELD_NUMBER: _ClassVar[int]
    chaincode: str
    name: str
    subject: str
    payload: bytes
    index: int
    transaction: bytes
    certificate: bytes
    def __init__(self, chaincode: _Optional[str] = ..., name: _Optional[str] = ..., subject: _Optional[str] = ..., payload: _Optional[bytes] = ..., index: _Optional[int] = ..., transaction: _Optional[bytes] = ..., certificate: _Optional[bytes] = ...) -> None: ...

class StatusRequest(_message.Message):
    __slots__ = ()
    def __init__(self) -> None: ...

class StatusResponse(_message.Message):
    __slots__ = ("version", "network", "network_label", "node_id", "node_name", "organisation", "role", "leader_id", "term", "height", "block_hash", "block_time", "state_digest", "committed", "last_index", "clock", "uptime_ms", "chaincodes", "refused", "executed", "peers", "subscribers", "payload_bytes_max", "resident_bytes", "first_height", "snapshot_height", "catching_up_to", "divergence", "in_flight", "in_flight_max", "waiting_control", "waiting_data", "data_directory", "disk_free_bytes", "disk_total_bytes", "disk_accepts", "certificates", "voters", "voters_connected", "certified", "lies", "console", "wall_clock", "attention", "certificate_rule", "open_stops", "faults", "depositions", "deposed")
    class RefusedEntry(_message.Message):
        __slots__ = ("key", "value")
        KEY_FIELD_NUMBER: _ClassVar[int]
        VALUE_FIELD_NUMBER: _ClassVar[int]
        key: int
        value: int
        def __init__(self, key: _Optional[int] = ..., value: _Optional[int] = ...) -> None: ...
    class ExecutedEntry(_message.Message):
        __slots__ = ("key", "value")
        KEY_FIELD_NUMBER: _ClassVar[int]
        VALUE_FIELD_NUMBER: _ClassVar[int]
        key: int
        value: int
        def __init__(self, key: _Optional[int] = ..., value: _Optional[int] = ...) -> None: ...
    VERSION_FIELD_NUMBER: _ClassVar[int]
    NETWORK_FIELD_NUMBER: _ClassVar[int]
    NETWORK_LABEL_FIELD_NUMBER: _ClassVar[int]
    NODE_ID_FIELD_NUMBER: _ClassVar[int]
    NODE_NAME_FIELD_NUMBER: _ClassVar[int]
    ORGANISATION_FIELD_NUMBER: _ClassVar[int]
    ROLE_FIELD_NUMBER: _ClassVar[int]
    LEADER_ID_FIELD_NUMBER: _ClassVar[int]
    TERM_FIELD_NUMBER: _ClassVar[int]
    HEIGHT_FIELD_NUMBER: _ClassVar[int]
    BLOCK_HASH_FIELD_NUMBER: _ClassVar[int]
    BLOCK_TIME_FIELD_NUMBER: _ClassVar[int]
    STATE_DIGEST_FIELD_NUMBER: _ClassVar[int]
    COMMITTED_FIELD_NUMBER: _ClassVar[int]
    LAST_INDEX_FIELD_NUMBER: _ClassVar[int]
    CLOCK_FIELD_NUMBER: _ClassVar[int]
    UPTIME_MS_FIELD_NUMBER: _ClassVar[int]
    CHAINCODES_FIELD_NUMBER: _ClassVar[int]
    REFUSED_FIELD_NUMBER: _ClassVar[int]
    EXECUTED_FIELD_NUMBER: _ClassVar[int]
    PEERS_FIELD_NUMBER: _ClassVar[int]
    SUBSCRIBERS_FIELD_NUMBER: _ClassVar[int]
    PAYLOAD_BYTES_MAX_FIELD_NUMBER: _ClassVar[int]
    RESIDENT_BYTES_FIELD_NUMBER: _ClassVar[int]
    FIRST_HEIGHT_FIELD_NUMBER: _ClassVar[int]
    SNAPSHOT_HEIGHT_FIELD_NUMBER: _ClassVar[int]
    CATCHING_UP_TO_FIELD_NUMBER: _ClassVar[int]
    DIVERGENCE_FIELD_NUMBER: _ClassVar[int]
    IN_FLIGHT_FIELD_NUMBER: _ClassVar[int]
    IN_FLIGHT_MAX_FIELD_NUMBER: _ClassVar[int]
    WAITING_CONTROL_FIELD_NUMBER: _ClassVar[int]
    WAITING_DATA_FIELD_NUMBER: _ClassVar[int]
    DATA_DIRECTORY_FIELD_NUMBER: _ClassVar[int]
    DISK_FREE_BYTES_FIELD_NUMBER: _ClassVar[int]
    DISK_TOTAL_BYTES_FIELD_NUMBER: _ClassVar[int]
    DISK_ACCEPTS_FIELD_NUMBER: _ClassVar[int]
    CERTIFICATES_FIELD_NUMBER: _ClassVar[int]
    VOTERS_FIELD_NUMBER: _ClassVar[int]
    VOTERS_CONNECTED_FIELD_NUMBER: _ClassVar[int]
    CERTIFIED_FIELD_NUMBER: _ClassVar[int]
    LIES_FIELD_NUMBER: _ClassVar[int]
    CONSOLE_FIELD_NUMBER: _ClassVar[int]
    WALL_CLOCK_FIELD_NUMBER: _ClassVar[int]
    ATTENTION_FIELD_NUMBER: _ClassVar[int]
    CERTIFICATE_RULE_FIELD_NUMBER: _ClassVar[int]
    OPEN_STOPS_FIELD_NUMBER: _ClassVar[int]
    FAULTS_FIELD_NUMBER: _ClassVar[int]
    DEPOSITIONS_FIELD_NUMBER: _ClassVar[int]
    DEPOSED_FIELD_NUMBER: _ClassVar[int]
    version: str
    network: bytes
    network_label: str
    node_id: int
    node_name: str
    organisation: str
    role: str
    leader_id: int
    term: int
    height: int
    block_hash: bytes
    block_time: int
    state_digest: bytes
    committed: int
    last_index: int
    clock: int
    uptime_ms: int
    chaincodes: _containers.RepeatedScalarFieldContainer[str]
    refused: _containers.ScalarMap[int, int]
    executed: _containers.ScalarMap[int, int]
    peers: _containers.RepeatedCompositeFieldContainer[PeerStatus]
    subscribers: int
    payload_bytes_max: int
    resident_bytes: int
    first_height: int
    snapshot_height: int
    catching_up_to: int
    divergence: str
    in_flight: int
    in_flight_max: int
    waiting_control: int
    waiting_data: int
    data_directory: str
    disk_free_bytes: int
    disk_total_bytes: int
    disk_accepts: str
    certificates: _containers.RepeatedCompositeFieldContainer[CertificateStatus]
    voters: int
    voters_connected: int
    certified: int
    lies: str
    console: str
    wall_clock: int
    attention: _containers.RepeatedCompositeFieldContainer[Attention]
    certificate_rule: CertificateRule
    open_stops: _containers.RepeatedCompositeFieldContainer[OpenStop]
    faults: str
    depositions: int
    deposed: str
    def __init__(self, version: _Optional[str] = ..., network: _Optional[bytes] = ..., network_label: _Optional[str] = ..., node_id: _Optional[int] = ..., node_name: _Optional[str] = ..., organisation: _Optional[str] = ..., role: _Optional[str] = ..., leader_id: _Optional[int] = ..., term: _Optional[int] = ..., height: _Optional[int] = ..., block_hash: _Optional[bytes] = ..., block_time: _Optional[int] = ..., state_digest: _Optional[bytes] = ..., committed: _Optional[int] = ..., last_index: _Optional[int] = ..., clock: _Optional[int] = ..., uptime_ms: _Optional[int] = ..., chaincodes: _Optional[_Iterable[str]] = ..., refused: _Optional[_Mapping[int, int]] = ..., executed: _Optional[_Mapping[int, int]] = ..., peers: _Optional[_Iterable[_Union[PeerStatus, _Mapping]]] = ..., subscribers: _Optional[int] = ..., payload_bytes_max: _Optional[int] = ..., resident_bytes: _Optional[int] = ..., first_height: _Optional[int] = ..., snapshot_height: _Optional[int] = ..., catching_up_to: _Optional[int] = ..., divergence: _Optional[str] = ..., in_flight: _Optional[int] = ..., in_flight_max: _Optional[int] = ..., waiting_control: _Optional[int] = ..., waiting_data: _Optional[int] = ..., data_directory: _Optional[str] = ..., disk_free_bytes: _Optional[int] = ..., disk_total_bytes: _Optional[int] = ..., disk_accepts: _Optional[str] = ..., certificates: _Optional[_Iterable[_Union[CertificateStatus, _Mapping]]] = ..., voters: _Optional[int] = ..., voters_connected: _Optional[int] = ..., certified: _Optional[int] = ..., lies: _Optional[str] = ..., console: _Optional[str] = ..., wall_clock: _Optional[int] = ..., attention: _Optional[_Iterable[_Union[Attention, _Mapping]]] = ..., certificate_rule: _Optional[_Union[CertificateRule, _Mapping]] = ..., open_stops: _Optional[_Iterable[_Union[OpenStop, _Mapping]]] = ..., faults: _Optional[str] = ..., depositions: _Optional[int] = ..., deposed: _Optional[str] = ...) -> None: ...

class CertificateRule(_message.Message):
    __slots__ = ("needed", "strict_since", "survives_crashes", "survives_lie", "survives_silence")
    NEEDED_FIELD_NUMBER: _ClassVar[int]
    STRICT_SINCE_FIELD_NUMBER: _ClassVar[int]
    SURVIVES_CRASHES_FIELD_NUMBER: _ClassVar[int]
    SURVIVES_LIE_FIELD_NUMBER: _ClassVar[int]
    SURVIVES_SILENCE_FIELD_NUMBER: _ClassVar[int]
    needed: int
    strict_since: int
    survives_crashes: int
    survives_lie: bool
    survives_silence: bool
    def __init__(self, needed: _Optional[int] = ..., strict_since: _Optional[int] = ..., survives_crashes: _Optional[int] = ..., survives_lie: _Optional[bool] = ..., survives_silence: _Optional[bool] = ...) -> None: ...

class OpenStop(_message.Message):
    __slots__ = ("id", "robot", "by", "not_after")
    ID_FIELD_NUMBER: _ClassVar[int]
    ROBOT_FIELD_NUMBER: _ClassVar[int]
    BY_FIELD_NUMBER: _ClassVar[int]
    NOT_AFTER_FIELD_NUMBER: _ClassVar[int]
    id: bytes
    robot: str
    by: str
    not_after: int
    def __init__(self, id: _Optional[bytes] = ..., robot: _Optional[str] = ..., by: _Optional[str] = ..., not_after: _Optional[int] = ...) -> None: ...

class Attention(_message.Message):
    __slots__ = ("check", "severity", "message", "next")
    CHECK_FIELD_NUMBER: _ClassVar[int]
    SEVERITY_FIELD_NUMBER: _ClassVar[int]
    MESSAGE_FIELD_NUMBER: _ClassVar[int]
    NEXT_FIELD_NUMBER: _ClassVar[int]
    check: str
    severity: str
    message: str
    next: str
    def __init__(self, check: _Optional[str] = ..., severity: _Optional[str] = ..., message: _Optional[str] = ..., next: _Optional[str] = ...) -> None: ...

class CertificateStatus(_message.Message):
    __slots__ = ("kind", "name", "not_before", "not_after")
    KIND_FIELD_NUMBER: _ClassVar[int]
    NAME_FIELD_NUMBER: _ClassVar[int]
    NOT_BEFORE_FIELD_NUMBER: _ClassVar[int]
    NOT_AFTER_FIELD_NUMBER: _ClassVar[int]
    kind: str
    name: str
    not_before: int
    not_after: int
    def __init__(self, kind: _Optional[str] = ..., name: _Optional[str] = ..., not_before: _Optional[int] = ..., not_after: _Optional[int] = ...) -> None: ...

class PeerStatus(_message.Message):
    __slots__ = ("node_id", "name", "organisation", "address", "voter", "matched", "connected", "role", "clock_offset_us", "clock_error_us")
    NODE_ID_FIELD_NUMBER: _ClassVar[int]
    NAME_FIELD_NUMBER: _ClassVar[int]
    ORGANISATION_FIELD_NUMBER: _ClassVar[int]
    ADDRESS_FIELD_NUMBER: _ClassVar[int]
    VOTER_FIELD_NUMBER: _ClassVar[int]
    MATCHED_FIELD_NUMBER: _ClassVar[int]
    CONNECTED_FIELD_NUMBER: _ClassVar[int]
    ROLE_FIELD_NUMBER: _ClassVar[int]
    CLOCK_OFFSET_US_FIELD_NUMBER: _ClassVar[int]
    CLOCK_ERROR_US_FIELD_NUMBER: _ClassVar[int]
    node_id: int
    name: str
    organisation: str
    address: str
    voter: bool
    matched: int
    connected: bool
    role: str
    clock_offset_us: int
    clock_error_us: int
    def __init__(self, node_id: _Optional[int] = ..., name: _Optional[str] = ..., organisation: _Optional[str] = ..., address: _Optional[str] = ..., voter: _Optional[bool] = ..., matched: _Optional[int] = ..., connected: _Optional[bool] = ..., role: _Optional[str] = ..., clock_offset_us: _Optional[int] = ..., clock_error_us: _Optional[int] = ...) -> None: ...

class NodesRequest(_message.Message):
    __slots__ = ()
    def __init__(self) -> None: ...

class NodesResponse(_message.Message):
    __slots__ = ("nodes",)
    NODES_FIELD_NUMBER: _ClassVar[int]
    nodes: _containers.RepeatedCompositeFieldContainer[NodeStatus]
    def __init__(self, nodes: _Optional[_Iterable[_Union[NodeStatus, _Mapping]]] = ...) -> None: ...

class NodeStatus(_message.Message):
    __slots__ = ("node_id", "name", "organisation", "status", "unreachable")
    NODE_ID_FIELD_NUMBER: _ClassVar[int]
    NAME_FIELD_NUMBER: _ClassVar[int]
    ORGANISATION_FIELD_NUMBER: _ClassVar[int]
    STATUS_FIELD_NUMBER: _ClassVar[int]
    UNREACHABLE_FIELD_NUMBER: _ClassVar[int]
    node_id: int
    name: str
    organisation: str
    status: StatusResponse
    unreachable: str
    def __init__(self, node_id: _Optional[int] = ..., name: _Optional[str] = ..., organisation: _Optional[str] = ..., status: _Optional[_Union[StatusResponse, _Mapping]] = ..., unreachable: _Optional[str] = ...) -> None: ...

class GetBlockRequest(_message.Message):
    __slots__ = ("height",)
    HEIGHT_FIELD_NUMBER: _ClassVar[int]
    height: int
    def __init__(self, height: _Optional[int] = ...) -> None: ...

class Block(_message.Message):
    __slots__ = ("height", "term", "time", "previous_hash", "root", "hash", "state_digest", "kind", "transactions", "events")
    HEIGHT_FIELD_NUMBER: _ClassVar[int]
    TERM_FIELD_NUMBER: _ClassVar[int]
    TIME_FIELD_NUMBER: _ClassVar[int]
    PREVIOUS_HASH_FIELD_NUMBER: _ClassVar[int]
    ROOT_FIELD_NUMBER: _ClassVar[int]
    HASH_FIELD_NUMBER: _ClassVar[int]
    STATE_DIGEST_FIELD_NUMBER: _ClassVar[int]
    KIND_FIELD_NUMBER: _ClassVar[int]
    TRANSACTIONS_FIELD_NUMBER: _ClassVar[int]
    EVENTS_FIELD_NUMBER: _ClassVar[int]
    height: int
    term: int
    time: int
    previous_hash: bytes
    root: bytes
    hash: bytes
    state_digest: bytes
    kind: str
    transactions: _containers.RepeatedCompositeFieldContainer[TransactionRecord]
    events: _containers.RepeatedCompositeFieldContainer[EventRecord]
    def __init__(self, height: _Optional[int] = ..., term: _Optional[int] = ..., time: _Optional[int] = ..., previous_hash: _Optional[bytes] = ..., root: _Optional[bytes] = ..., hash: _Optional[bytes] = ..., state_digest: _Optional[bytes] = ..., kind: _Optional[str] = ..., transactions: _Optional[_Iterable[_Union[TransactionRecord, _Mapping]]] = ..., events: _Optional[_Iterable[_Union[EventRecord, _Mapping]]] = ...) -> None: ...

class GetTransactionRequest(_message.Message):
    __slots__ = ("id", "certified_within_ms")
    ID_FIELD_NUMBER: _ClassVar[int]
    CERTIFIED_WITHIN_MS_FIELD_NUMBER: _ClassVar[int]
    id: bytes
    certified_within_ms: int
    def __init__(self, id: _Optional[bytes] = ..., certified_within_ms: _Optional[int] = ...) -> None: ...

class TransactionRecord(_message.Message):
    __slots__ = ("id", "height", "index", "time", "verdict", "response", "transaction", "creator", "events", "certified", "certificate_due")
    ID_FIELD_NUMBER: _ClassVar[int]
    HEIGHT_FIELD_NUMBER: _ClassVar[int]
    INDEX_FIELD_NUMBER: _ClassVar[int]
    TIME_FIELD_NUMBER: _ClassVar[int]
    VERDICT_FIELD_NUMBER: _ClassVar[int]
    RESPONSE_FIELD_NUMBER: _ClassVar[int]
    TRANSACTION_FIELD_NUMBER: _ClassVar[int]
    CREATOR_FIELD_NUMBER: _ClassVar[int]
    EVENTS_FIELD_NUMBER: _ClassVar[int]
    CERTIFIED_FIELD_NUMBER: _ClassVar[int]
    CERTIFICATE_DUE_FIELD_NUMBER: _ClassVar[int]
    id: bytes
    height: int
    index: int
    time: int
    verdict: Verdict
    response: bytes
    transaction: bytes
    creator: str
    events: _containers.RepeatedCompositeFieldContainer[EventRecord]
    certified: bool
    certificate_due: bool
    def __init__(self, id: _Optional[bytes] = ..., height: _Optional[int] = ..., index: _Optional[int] = ..., time: _Optional[int] = ..., verdict: _Optional[_Union[Verdict, _Mapping]] = ..., response: _Optional[bytes] = ..., transaction: _Optional[bytes] = ..., creator: _Optional[str] = ..., events: _Optional[_Iterable[_Union[EventRecord, _Mapping]]] = ..., certified: _Optional[bool] = ..., certificate_due: _Optional[bool] = ...) -> None: ...

class GovernanceRequest(_message.Message):
    __slots__ = ("after",)
    AFTER_FIELD_NUMBER: _ClassVar[int]
    after: int
    def __init__(self, after: _Optional[int] = ...) -> None: ...

class GovernanceStep(_message.Message):
    __slots__ = ("genesis", "changes", "proof")
    GENESIS_FIELD_NUMBER: _ClassVar[int]
    CHANGES_FIELD_NUMBER: _ClassVar[int]
    PROOF_FIELD_NUMBER: _ClassVar[int]
    genesis: bytes
    changes: _containers.RepeatedCompositeFieldContainer[GovernanceChange]
    proof: bytes
    def __init__(self, genesis: _Optional[bytes] = ..., changes: _Optional[_Iterable[_Union[GovernanceChange, _Mapping]]] = ..., proof: _Optional[bytes] = ...) -> None: ...

class GovernanceChange(_message.Message):
    __slots__ = ("height", "writes")
    HEIGHT_FIELD_NUMBER: _ClassVar[int]
    WRITES_FIELD_NUMBER: _ClassVar[int]
    height: int
    writes: bytes
    def __init__(self, height: _Optional[int] = ..., writes: _Optional[bytes] = ...) -> None: ...

class ProveRequest(_message.Message):
    __slots__ = ("height", "verdicts")
    HEIGHT_FIELD_NUMBER: _ClassVar[int]
    VERDICTS_FIELD_NUMBER: _ClassVar[int]
    height: int
    verdicts: _containers.RepeatedScalarFieldContainer[int]
    def __init__(self, height: _Optional[int] = ..., verdicts: _Optional[_Iterable[int]] = ...) -> None: ...

class ProveResponse(_message.Message):
    __slots__ = ("proof",)
    PROOF_FIELD_NUMBER: _ClassVar[int]
    proof: bytes
    def __init__(self, proof: _Optional[bytes] = ...) -> None: ...

class ProveTransactionRequest(_message.Message):
    __slots__ = ("id",)
    ID_FIELD_NUMBER: _ClassVar[int]
    id: bytes
    def __init__(self, id: _Optional[bytes] = ...) -> None: ...

class ProveTransactionResponse(_message.Message):
    __slots__ = ("link",)
    LINK_FIELD_NUMBER: _ClassVar[int]
    link: bytes
    def __init__(self, link: _Optional[bytes] = ...) -> None: ...

class DenialsRequest(_message.Message):
    __slots__ = ("limit",)
    LIMIT_FIELD_NUMBER: _ClassVar[int]
    limit: int
    def __init__(self, limit: _Optional[int] = ...) -> None: ...

class DenialsResponse(_message.Message):
    __slots__ = ("denials",)
    DENIALS_FIELD_NUMBER: _ClassVar[int]
    denials: _containers.RepeatedCompositeFieldContainer[Denial]
    def __init__(self, denials: _Optional[_Iterable[_Union[Denial, _Mapping]]] = ...) -> None: ...

class Denial(_message.Message):
    __slots__ = ("time", "who", "chaincode", "function", "subject", "verdict", "count")
    TIME_FIELD_NUMBER: _ClassVar[int]
    WHO_FIELD_NUMBER: _ClassVar[int]
    CHAINCODE_FIELD_NUMBER: _ClassVar[int]
    FUNCTION_FIELD_NUMBER: _ClassVar[int]
    SUBJECT_FIELD_NUMBER: _ClassVar[int]
    VERDICT_FIELD_NUMBER: _ClassVar[int]
    COUNT_FIELD_NUMBER: _ClassVar[int]
    time: int
    who: str
    chaincode: str
    function: str
    subject: str
    verdict: Verdict
    count: int
    def __init__(self, time: _Optional[int] = ..., who: _Optional[str] = ..., chaincode: _Optional[str] = ..., function: _Optional[str] = ..., subject: _Optional[str] = ..., verdict: _Optional[_Union[Verdict, _Mapping]] = ..., count: _Optional[int] = ...) -> None: ...

class AuditRequest(_message.Message):
    __slots__ = ("robot", "user", "organisation", "code", "since", "until", "after", "limit")
    ROBOT_FIELD_NUMBER: _ClassVar[int]
    USER_FIELD_NUMBER: _ClassVar[int]
    ORGANISATION_FIELD_NUMBER: _ClassVar[int]
    CODE_FIELD_NUMBER: _ClassVar[int]
    SINCE_FIELD_NUMBER: _ClassVar[int]
    UNTIL_FIELD_NUMBER: _ClassVar[int]
    AFTER_FIELD_NUMBER: _ClassVar[int]
    LIMIT_FIELD_NUMBER: _ClassVar[int]
    robot: str
    user: str
    organisation: str
    code: int
    since: int
    until: int
    after: bytes
    limit: int
    def __init__(self, robot: _Optional[str] = ..., user: _Optional[str] = ..., organisation: _Optional[str] = ..., code: _Optional[int] = ..., since: _Optional[int] = ..., until: _Optional[int] = ..., after: _Optional[bytes] = ..., limit: _Optional[int] = ...) -> None: ...

class AuditResponse(_message.Message):
    __slots__ = ("rows", "after", "more", "from_height", "height", "executed")
    ROWS_FIELD_NUMBER: _ClassVar[int]
    AFTER_FIELD_NUMBER: _ClassVar[int]
    MORE_FIELD_NUMBER: _ClassVar[int]
    FROM_HEIGHT_FIELD_NUMBER: _ClassVar[int]
    HEIGHT_FIELD_NUMBER: _ClassVar[int]
    EXECUTED_FIELD_NUMBER: _ClassVar[int]
    rows: _containers.RepeatedCompositeFieldContainer[AuditRow]
    after: bytes
    more: bool
    from_height: int
    height: int
    executed: int
    def __init__(self, rows: _Optional[_Iterable[_Union[AuditRow, _Mapping]]] = ..., after: _Optional[bytes] = ..., more: _Optional[bool] = ..., from_height: _Optional[int] = ..., height: _Optional[int] = ..., executed: _Optional[int] = ...) -> None: ...

class AuditRow(_message.Message):
    __slots__ = ("time", "height", "decision", "who", "by", "robot", "subject", "code", "count", "first", "last", "last_height", "epoch", "policy_version", "detail", "found", "transaction", "told_by", "policies", "action")
    TIME_FIELD_NUMBER: _ClassVar[int]
    HEIGHT_FIELD_NUMBER: _ClassVar[int]
    DECISION_FIELD_NUMBER: _ClassVar[int]
    WHO_FIELD_NUMBER: _ClassVar[int]
    BY_FIELD_NUMBER: _ClassVar[int]
    ROBOT_FIELD_NUMBER: _ClassVar[int]
    SUBJECT_FIELD_NUMBER: _ClassVar[int]
    CODE_FIELD_NUMBER: _ClassVar[int]
    COUNT_FIELD_NUMBER: _ClassVar[int]
    FIRST_FIELD_NUMBER: _ClassVar[int]
    LAST_FIELD_NUMBER: _ClassVar[int]
    LAST_HEIGHT_FIELD_NUMBER: _ClassVar[int]
    EPOCH_FIELD_NUMBER: _ClassVar[int]
    POLICY_VERSION_FIELD_NUMBER: _ClassVar[int]
    DETAIL_FIELD_NUMBER: _ClassVar[int]
    FOUND_FIELD_NUMBER: _ClassVar[int]
    TRANSACTION_FIELD_NUMBER: _ClassVar[int]
    TOLD_BY_FIELD_NUMBER: _ClassVar[int]
    POLICIES_FIELD_NUMBER: _ClassVar[int]
    ACTION_FIELD_NUMBER: _ClassVar[int]
    time: int
    height: int
    decision: str
    who: str
    by: str
    robot: str
    subject: str
    code: int
    count: int
    first: int
    last: int
    last_height: int
    epoch: int
    policy_version: int
    detail: str
    found: str
    transaction: bytes
    told_by: str
    policies: _containers.RepeatedScalarFieldContainer[str]
    action: str
    def __init__(self, time: _Optional[int] = ..., height: _Optional[int] = ..., decision: _Optional[str] = ..., who: _Optional[str] = ..., by: _Optional[str] = ..., robot: _Optional[str] = ..., subject: _Optional[str] = ..., code: _Optional[int] = ..., count: _Optional[int] = ..., first: _Optional[int] = ..., last: _Optional[int] = ..., last_height: _Optional[int] = ..., epoch: _Optional[int] = ..., policy_version: _Optional[int] = ..., detail: _Optional[str] = ..., found: _Optional[str] = ..., transaction: _Optional[bytes] = ..., told_by: _Optional[str] = ..., policies: _Optional[_Iterable[str]] = ..., action: _Optional[str] = ...) -> None: ...

class TransferLeadershipRequest(_message.Message):
    __slots__ = ("node_id",)
    NODE_ID_FIELD_NUMBER: _ClassVar[int]
    node_id: int
    def __init__(self, node_id: _Optional[int] = ...) -> None: ...

class TransferLeadershipResponse(_message.Message):
    __slots__ = ("verdict", "leader_id", "term")
    VERDICT_FIELD_NUMBER: _ClassVar[int]
    LEADER_ID_FIELD_NUMBER: _ClassVar[int]
    TERM_FIELD_NUMBER: _ClassVar[int]
    verdict: Verdict
    leader_id: int
    term: int
    def __init__(self, verdict: _Optional[_Union[Verdict, _Mapping]] = ..., leader_id: _Optional[int] = ..., term: _Optional[int] = ...) -> None: ...
