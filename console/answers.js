// Types of answers, for the check of types alone: this file is not served. Names are those of docs/http.md and docs/output.md, and
// of the chaincodes (crates/contract).

/**
 * @typedef {{ kind: string, name: string, not_before: number, not_after: number }} Certificate
 * @typedef {{ node_id: number, name: string, organisation: string, address: string, role: string, voter: boolean, connected: boolean }} Peer
 * @typedef {{ path: string, free_bytes: number, total_bytes: number, accepts: string }} Disk
 * @typedef {{ check: string, severity: "critical" | "error" | "warning", message: string, next: string }} Attention
 * @typedef {{
 *   version: string, network_label: string, node_id: number, node_name: string, organisation: string, role: string, leader_id: number,
 *   term: number, height: number, committed: number, catching_up_to: number | null, certified: number, clock: number,
 *   uptime_ms: number, peers: Peer[], subscribers: number, resident_bytes: number, in_flight: number, in_flight_max: number,
 *   voters: number, voters_reachable: number, disk: Disk, certificates: Certificate[], attention: Attention[], divergence?: string, lies?: string,
 *   open_stops?: { transaction: string, robot: string, by: string, not_after: number }[]
 * }} Status
 * @typedef {{ id: number, name: string, organisation: string, reachable: boolean, reason?: string, status: Status | null }} NodeOfNetwork
 */

/**
 * @typedef {{ encoding: "json", response: any } | { encoding: "text" | "hex", response: string }} Answer
 * @typedef {{ id: string, index: number, chaincode: string, function: string, args: Answer[], not_after: number, creator?: string }} Call
 * @typedef {{ chaincode: string, name: string, subject: string, payload: Answer, transaction?: Call }} LedgerEvent
 * @typedef {{ height: number, time: number, events: LedgerEvent[], early?: boolean }} Delivery
 * @typedef {Call & { height: number, time: number, creator: string, code: string, message: string, events: LedgerEvent[] }} Transaction
 * @typedef {{
 *   height: number, term: number, time: number, kind: string, hash: string, previous_hash: string, root: string,
 *   state_digest: string, transactions: Transaction[], events: LedgerEvent[]
 * }} Block
 * @typedef {{
 *   time: number, height: number, decision: string, who: string, by: string, robot: string, subject: string, code: string,
 *   count: number, detail: string, transaction: string
 * }} AuditRow
 * @typedef {{ rows: AuditRow[], more: boolean }} Audit
 */

/**
 * @typedef {{
 *   service: string, robot: string, topic: string, type: string, mode: string, direction: string, holders: string[], epoch: number,
 *   expires: number, waiting?: number, side_door?: { topic: string, since: number }
 * }} Service
 * @typedef {{
 *   Name: string, organisation: string, attribute_required: string, services: Service[],
 *   stopped?: { by: string, reason: string, since: number }
 * }} Robot
 * @typedef {{ contender: string, position: number, priority: number, since: number, expected?: number, task?: number }} Position
 * @typedef {{ line: Position[] }} Queue
 * @typedef {{
 *   id: number, service: string, submitter: string, state: string, reached: number, total: number, frame: string, priority: number,
 *   not_before?: number, deadline?: number, submitted: number, started?: number, ended?: number, reason?: string
 * }} Task
 * @typedef {{ organisation: string, id: string, text: string }} Policy
 * @typedef {{ line: number, effect: string, meaning: string, when: string[], limits: string[], except: string[], unmatched: boolean }} Meaning
 * @typedef {{ line: number, kind: string, name: string, near?: string }} UnknownName
 * @typedef {{ policies: Meaning[], unknown: UnknownName[] }} PolicyCheck
 * @typedef {{
 *   version: number, by: string, message: string, time: number, height: number, break_glass?: boolean, restores?: number,
 *   policies?: { id: string, text?: string }[]
 * }} PolicySet
 * @typedef {{
 *   who: string, action: string, service: string, allowed: boolean, code: string, reason: string, found: string, wanted: string,
 *   next: string, policies: string[], policy_version: number,
 *   conditions: { policy: string, condition: string, found: string, wanted: string }[]
 * }} Decision
 * @typedef {{
 *   name: string, organisation: string, role: string, attributes: Record<string, string>, by: string,
 *   secret?: { expires: number } | null, certificates: { not_after: number, revoked: boolean }[]
 * }} Registered
 */

/**
 * @typedef {{ of: string, action: string, policies: string[], rule?: string, limits?: Record<string, unknown>, closed?: string[] }} Right
 * @typedef {{ who: string, role: string, rights: Right[] }} PersonRights
 * @typedef {{
 *   resource: string, with: string, attribute?: string, from?: number, until?: number, hours?: string, max_linear?: string,
 *   max_angular?: string, rate?: string, priority?: string, read_only?: boolean
 * }} ShareTerms
 * @typedef {Partial<ShareTerms> & { organisation: string, id: string, text: string, edited?: boolean }} Share
 * @typedef {{ who: string, of: string, action: string, limits?: Record<string, unknown> }} RightChange
 * @typedef {{
 *   gained?: RightChange[], lost?: RightChange[], incomplete?: boolean,
 *   limited?: { who: string, of: string, action: string, before: Record<string, unknown>, after: Record<string, unknown> }[]
 * }} RightsDiff
 * @typedef {{
 *   id: string, text: string, meaning: Meaning[], replaces?: string, keeps_built_in: boolean, trusted: boolean,
 *   unknown: UnknownName[], set: unknown, diff: RightsDiff
 * }} SharePreview
 * @typedef {{ id: string, text: string, set: unknown, diff: RightsDiff, still: PersonRights[] }} UnsharePreview
 */

export {};
