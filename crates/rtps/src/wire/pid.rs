//! Identifiers of parameters (§9.6.3, §9.6.4).

/// Data with this parameter must not be taken by an implementation that does not know it (§9.6.2.2.1).
pub(crate) const MUST_UNDERSTAND: u16 = 0x4000;

pub(crate) const PAD: u16 = 0x0000;
pub(crate) const SENTINEL: u16 = 0x0001;
pub(crate) const PARTICIPANT_LEASE_DURATION: u16 = 0x0002;
pub(crate) const TOPIC_NAME: u16 = 0x0005;
pub(crate) const TYPE_NAME: u16 = 0x0007;
pub(crate) const DOMAIN_ID: u16 = 0x000f;
/// Its number has the must-understand bit.
pub(crate) const DOMAIN_TAG: u16 = 0x4014;
pub(crate) const PROTOCOL_VERSION: u16 = 0x0015;
pub(crate) const VENDOR_ID: u16 = 0x0016;
pub(crate) const RELIABILITY: u16 = 0x001a;
pub(crate) const LIVELINESS: u16 = 0x001b;
pub(crate) const DURABILITY: u16 = 0x001d;
pub(crate) const OWNERSHIP: u16 = 0x001f;
pub(crate) const DEADLINE: u16 = 0x0023;
pub(crate) const LATENCY_BUDGET: u16 = 0x0027;
pub(crate) const PARTITION: u16 = 0x0029;
pub(crate) const LIFESPAN: u16 = 0x002b;
pub(crate) const USER_DATA: u16 = 0x002c;
pub(crate) const UNICAST_LOCATOR: u16 = 0x002f;
pub(crate) const MULTICAST_LOCATOR: u16 = 0x0030;
pub(crate) const DEFAULT_UNICAST_LOCATOR: u16 = 0x0031;
pub(crate) const METATRAFFIC_UNICAST_LOCATOR: u16 = 0x0032;
pub(crate) const METATRAFFIC_MULTICAST_LOCATOR: u16 = 0x0033;
pub(crate) const HISTORY: u16 = 0x0040;
pub(crate) const DEFAULT_MULTICAST_LOCATOR: u16 = 0x0048;
pub(crate) const PARTICIPANT_GUID: u16 = 0x0050;
pub(crate) const BUILTIN_ENDPOINT_SET: u16 = 0x0058;
pub(crate) const ENDPOINT_GUID: u16 = 0x005a;
pub(crate) const ENTITY_NAME: u16 = 0x0062;
pub(crate) const KEY_HASH: u16 = 0x0070;
pub(crate) const STATUS_INFO: u16 = 0x0071;
pub(crate) const DATA_REPRESENTATION: u16 = 0x0073;
pub(crate) const RELATED_SAMPLE_IDENTITY: u16 = 0x0083;
/// `PID_RELATED_SAMPLE_IDENTITY` of Fast DDS before 2.11, and of RTI Connext.
pub(crate) const RELATED_SAMPLE_IDENTITY_CUSTOM: u16 = 0x800f;

/// Parameters that are known and have no effect here: a must-understand bit on them rejects nothing.
const WITHOUT_EFFECT: [u16; 43] = [
    0x0004, // TIME_BASED_FILTER
    0x0006, // OWNERSHIP_STRENGTH
    0x000b, // METATRAFFIC_MULTICAST_IPADDRESS
    0x000c, // DEFAULT_UNICAST_IPADDRESS
    0x000d, // METATRAFFIC_UNICAST_PORT
    0x000e, // DEFAULT_UNICAST_PORT
    0x0011, // MULTICAST_IPADDRESS
    0x001e, // DURABILITY_SERVICE
    0x0021, // PRESENTATION
    0x0025, // DESTINATION_ORDER
    0x002d, // GROUP_DATA
    0x002e, // TOPIC_DATA
    0x0034, // PARTICIPANT_MANUAL_LIVELINESS_COUNT
    0x0035, // CONTENT_FILTER_PROPERTY
    0x0041, // RESOURCE_LIMITS
    0x0043, // EXPECTS_INLINE_QOS
    0x0044, // PARTICIPANT_BUILTIN_ENDPOINTS
    0x0045, // METATRAFFIC_UNICAST_IPADDRESS
    0x0046, // METATRAFFIC_MULTICAST_PORT
    0x0049, // TRANSPORT_PRIORITY
    0x0052, // GROUP_GUID
    0x0053, // GROUP_ENTITYID
    0x0055, // CONTENT_FILTER_INFO
    0x0059, // PROPERTY_LIST
    0x0060, // TYPE_MAX_SIZE_SERIALIZED
    0x0069, // TYPE_IDV1
    0x0072, // TYPE_OBJECTV1
    0x0074, // TYPE_CONSISTENCY_ENFORCEMENT
    0x0075, // TYPE_INFORMATION
    0x0077, // BUILTIN_ENDPOINT_QOS
    0x0080, // SERVICE_INSTANCE_NAME
    0x0081, // RELATED_ENTITY_GUID
    0x0082, // TOPIC_ALIASES
    0x1001, // IDENTITY_TOKEN
    0x1002, // PERMISSIONS_TOKEN
    0x1003, // DATA_TAGS
    0x1004, // ENDPOINT_SECURITY_INFO
    0x1005, // PARTICIPANT_SECURITY_INFO
    0x1006, // IDENTITY_STATUS_TOKEN
    0x1010, // DIGITAL_SIGNATURE_ALGO
    0x1011, // KEY_ESTABLISHMENT_ALGO
    0x1012, // SYMMETRIC_CIPHER_ALGO
    0x1013, // ENDPOINT_SYMMETRIC_CIPHER_ALGO
];

/// Must data with this parameter be rejected, because no code reads it and its sender demands that?
pub(crate) fn rejects(id: u16) -> bool {
    id & MUST_UNDERSTAND != 0 && !WITHOUT_EFFECT.contains(&(id & !MUST_UNDERSTAND))
}
