// The JSON of the chaincodes (docs/events.md, crates/contract), as far as it is shown.

export interface Service {
  service: string;
  robot: string;
  topic: string;
  type: string;
  mode: string;
  direction: string;
  lease_ms: number;
  holder: string;
  holders: string[];
  epoch: number;
  expires: number;
  waiting?: number;
  side_door?: { topic: string; publishers: string[] | number; since: number };
  capabilities?: { publishing: string };
}

export interface Robot {
  Name: string;
  organisation: string;
  attribute_required: string;
  services: Service[];
  attributes?: Record<string, unknown>;
  stopped?: { by: string; reason: string; since: number };
}

export interface Grant {
  service: string;
  holder: string;
  epoch: number;
  expires: number;
  lease_ms: number;
  taken?: string;
}

export interface Place {
  contender: string;
  position: number;
  priority: number;
  since: number;
  expected?: number;
}

export interface Line {
  service: string;
  holders: Grant[];
  line: Place[];
  pending?: { contender: string; confirmed: string[]; wanted: number }[];
}

export interface Policy {
  organisation: string;
  id: string;
  text: string;
}

export interface PolicySet {
  version: number;
  by: string;
  message: string;
  time: number;
  height: number;
  approved_by?: string[];
  break_glass?: boolean;
  restores?: number;
  policies?: { id: string; text?: string }[];
}

export interface Can {
  who: string;
  action: string;
  service: string;
  allowed: boolean;
  code: string;
  name: string;
  reason: string;
  found: string;
  wanted: string;
  next: string;
  policies: string[];
  conditions: { policy: string; condition: string; found: string; wanted: string }[];
  policy_version: number;
}

export interface Registered {
  name: string;
  organisation: string;
  role: string;
  attributes: Record<string, string>;
  by: string;
  secret?: { expires: number } | null;
  certificates: { serial: string; not_before: number; not_after: number; revoked: boolean }[];
}
