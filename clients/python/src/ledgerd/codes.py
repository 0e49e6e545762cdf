"""The stable codes of refusals. The table is crates/base/src/rejection/code.rs; a test compares them."""

from enum import Enum
from typing import Final


class Kind(Enum):
    """How a program should react to a refusal. `ledgerctl` ends with the value as its exit code."""

    OK = 0
    FAILURE = 1
    DENIED = 2
    INVALID = 3
    UNREACHABLE = 4
    CONFLICT = 5


CODES: Final[dict[int, tuple[str, Kind]]] = {
    0: ("OK", Kind.OK),
    1001: ("MALFORMED", Kind.INVALID),
    1002: ("TOO_LARGE", Kind.INVALID),
    1003: ("WRONG_NETWORK", Kind.INVALID),
    1004: ("BAD_SIGNATURE", Kind.DENIED),
    1005: ("UNKNOWN_CREATOR", Kind.INVALID),
    1006: ("EXPIRED", Kind.INVALID),
    1007: ("NOT_AFTER_TOO_FAR", Kind.INVALID),
    1008: ("DUPLICATE", Kind.INVALID),
    1009: ("UNKNOWN_CHAINCODE", Kind.INVALID),
    1010: ("UNKNOWN_FUNCTION", Kind.INVALID),
    1011: ("BAD_ARGUMENT", Kind.INVALID),
    1012: ("CHAINCODE_PANIC", Kind.FAILURE),
    1013: ("NOT_FOUND", Kind.INVALID),
    1014: ("LIMIT_EXCEEDED", Kind.INVALID),
    1015: ("REFUSED", Kind.DENIED),
    1016: ("PRUNED", Kind.INVALID),
    1017: ("QUERY_ONLY", Kind.INVALID),
    1018: ("OVER_BUDGET", Kind.INVALID),
    2001: ("UNTRUSTED", Kind.DENIED),
    2002: ("CERTIFICATE_EXPIRED", Kind.DENIED),
    2003: ("CERTIFICATE_NOT_YET_VALID", Kind.DENIED),
    2004: ("REVOKED", Kind.DENIED),
    2005: ("CERTIFICATE_MALFORMED", Kind.INVALID),
    2006: ("WRONG_ROLE", Kind.DENIED),
    2007: ("ENROLMENT_REFUSED", Kind.DENIED),
    2008: ("CERTIFICATE_REQUIRED", Kind.DENIED),
    2009: ("ALREADY_REGISTERED", Kind.INVALID),
    2010: ("NOT_INVITED", Kind.DENIED),
    2011: ("NOT_A_MEMBER", Kind.DENIED),
    2012: ("CA_ELSEWHERE", Kind.UNREACHABLE),
    2013: ("OLD_LIST", Kind.INVALID),
    2014: ("LIST_STALE", Kind.DENIED),
    2020: ("CLOCK_OFF", Kind.FAILURE),
    3001: ("MISSING_ATTRIBUTE", Kind.DENIED),
    3002: ("DENIED_BY_POLICY", Kind.DENIED),
    3003: ("UNKNOWN_ROBOT", Kind.INVALID),
    3004: ("UNKNOWN_SERVICE", Kind.INVALID),
    3005: ("HELD", Kind.CONFLICT),
    3006: ("NOT_HOLDER", Kind.DENIED),
    3007: ("STALE_EPOCH", Kind.DENIED),
    3008: ("STALE_SEQUENCE", Kind.INVALID),
    3009: ("NOT_OWNER", Kind.DENIED),
    3010: ("NOT_ADMIN", Kind.DENIED),
    3011: ("ALREADY_EXISTS", Kind.INVALID),
    3012: ("WRONG_TYPE", Kind.INVALID),
    3013: ("POLICY_ERROR", Kind.DENIED),
    3014: ("POLICY_INVALID", Kind.INVALID),
    3015: ("LAST_ONE", Kind.INVALID),
    3016: ("UNKNOWN_MODE", Kind.INVALID),
    3017: ("RULES_NOT_SPOKEN", Kind.INVALID),
    3018: ("NEEDS_APPROVAL", Kind.DENIED),
    3019: ("QUOTA_REACHED", Kind.INVALID),
    3020: ("STOPPED", Kind.CONFLICT),
    3021: ("LINE_FULL", Kind.CONFLICT),
    3022: ("NOT_DELEGABLE", Kind.CONFLICT),
    3023: ("POLICIES_CHANGED", Kind.CONFLICT),
    3024: ("NOBODY_MAY_PUBLISH", Kind.CONFLICT),
    3025: ("READERS_CHANGED", Kind.CONFLICT),
    4001: ("UNREACHABLE", Kind.UNREACHABLE),
    4002: ("NO_LEADER", Kind.UNREACHABLE),
    4003: ("OVERLOADED", Kind.UNREACHABLE),
    4004: ("TIMEOUT", Kind.UNREACHABLE),
    4005: ("BEHIND", Kind.UNREACHABLE),
    4006: ("SHUTTING_DOWN", Kind.UNREACHABLE),
    4007: ("CLOCK_JUMPED", Kind.UNREACHABLE),
    4008: ("CLOCK_OUT_OF_BOUNDS", Kind.UNREACHABLE),
    5001: ("DISK_FULL", Kind.FAILURE),
    5002: ("CORRUPT", Kind.FAILURE),
    5003: ("DISK_FAILED", Kind.FAILURE),
    5004: ("CHAIN_INVALID", Kind.FAILURE),
    5005: ("INTERNAL", Kind.FAILURE),
    5006: ("DIVERGED", Kind.FAILURE),
    5007: ("UNKNOWN_RULES", Kind.FAILURE),
    5008: ("FORKED", Kind.FAILURE),
    5009: ("CONTRADICTED", Kind.FAILURE),
    6001: ("BAD_NAME", Kind.INVALID),
    6002: ("MIDDLEWARE_FAILED", Kind.FAILURE),
    6003: ("BAD_MESSAGE", Kind.INVALID),
    7001: ("BAD_CONFIGURATION", Kind.INVALID),
    7002: ("BAD_FILE", Kind.INVALID),
    7003: ("NO_CONTEXT", Kind.INVALID),
}
"""The name and the kind of each code by its number."""
