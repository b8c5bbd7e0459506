// The server's answers (src/conetl/web/models.py) and how to ask for them. Lengths in metres, places as offsets from origin_m.

export type Vec3 = [number, number, number];
/** What a drive did to a cone; "unchanged" only between two instants. */
export type ChangeKind =
  | "added" | "confirmed" | "moved" | "removed" | "missed" | "height_changed" | "split" | "merged" | "unchanged";

export interface MapItem {
  map_name: string;
  srid: number;
  changeset_count: number;
  feature_count: number;
  last_committed_at: string | null;
}

export interface TimelineItem {
  changeset_no: number;
  changeset_id: string;
  drive_id: string;
  drive_uuid: string;
  captured_from: string;
  captured_to: string;
  valid_at: string;
  committed_at: string;
  known_before: string;
  added_count: number;
  confirmed_count: number;
  moved_count: number;
  removed_count: number;
  missed_count: number;
  height_changed_count: number;
  split_count: number;
  merged_count: number;
  frame_pair_count: number;
  rejection_count: number;
  /** False where it was reverted, or a later analysis of the same recording took its place. */
  counts: boolean;
}

export interface Timeline {
  map_name: string;
  srid: number;
  origin_m: Vec3;
  changesets: TimelineItem[];
}

export interface Feature {
  feature_id: string;
  version: number;
  xyz_m: Vec3;
  cov_m2: number[];
  cone_height_m: number;
  existence_probability: number;
  observation_count: number;
}

export interface Change {
  feature_id: string;
  kind: ChangeKind;
  shift_m: number | null;
  old_xyz_m: Vec3 | null;
  xyz_m: Vec3;
  cone_height_m: number;
  existence_probability: number;
  observation_count: number;
  version: number;
}

export interface HistoryItem {
  changeset_no: number;
  drive_id: string;
  captured_from: string;
  kind: Exclude<ChangeKind, "unchanged">;
  changed_at: string;
  committed_at: string;
  version: number;
  shift_m: number | null;
  other_feature_id: string | null;
  frames_empty: number | null;
  xyz_m: Vec3;
  map_xyz_m: Vec3;
  cov_m2: [number, number, number, number, number, number];
  cone_height_m: number;
  cone_height_sigma_m: number;
  existence_probability: number;
  observation_count: number;
  first_seen_at: string;
  last_seen_at: string;
  sighting_count: number;
  /** Drives that saw it, and that looked in vain, up to this one. */
  seen_count: number;
  missed_count: number;
}

export interface Sighting {
  changeset_no: number;
  drive_id: string;
  drive_uuid: string;
  frame_index: number;
  match_index: number;
  captured_at: string;
  xyz_m: Vec3;
  range_m: number;
  residual_rms_px: number;
  camera_xyz_m: Vec3;
  map_R_camera: [Vec3, Vec3, Vec3];
  corners: [Vec3, Vec3, Vec3, Vec3];
  left: { score: number; h_px: number };
  right: { score: number; h_px: number };
}

export interface Trajectory {
  drive_id: string;
  drive_uuid: string;
  xyz_m: Vec3[];
}

export interface BaseLayer {
  layer_name: string;
  kind: "points" | "lines";
  files: number;
  count: number;
}

/** A square of points; its side is 4096 m / 2^level. */
export interface BaseTile {
  level: number;
  points: number;
  origin_m: Vec3;
  scale_m: Vec3;
  high_m: number;
  sha256: string;
}

export interface BaseLine {
  kind: string;
  subtype: string | null;
  /** x, y, z of one vertex after the other. */
  xyz_m: number[];
}

/** What a person decided and nobody took back. */
export interface Decision {
  decision_id: string;
  kind: "suppress" | "pin" | "revert";
  /** Of a place: what lies within radius_m of it. */
  xy_m: [number, number] | null;
  radius_m: number | null;
  feature_id: string | null;
  changeset_id: string | null;
  drive_id: string | null;
  decided_by: string | null;
  reason: string;
  decided_at: string;
}

export interface Decisions {
  /** Whether this server takes decisions from holders of its writer token. */
  writable: boolean;
  decisions: Decision[];
}

export interface Decided {
  decision_id: string;
  versions_written: number;
  replayed: number;
}

export type Wish = { decided_by: string; reason: string } & (
  | { kind: "suppress" | "pin"; feature_id: string; expected_version: number; radius_m: number }
  | { kind: "revert"; changeset_id: string }
  | { kind: "withdraw"; decision_id: string }
);

/** What the server refused, in its own words; `status` is 0 where it could not be reached. */
export class ApiError extends Error {
  constructor(
    message: string,
    readonly status: number,
    /** The whole answer, where it was JSON. */
    readonly body: unknown = null,
  ) {
    super(message);
  }
}

async function ask(path: string, init: RequestInit = {}): Promise<Response> {
  let response: Response;
  try {
    response = await fetch(`./api/${path}`, init);
  } catch (error) {
    if (error instanceof DOMException && error.name === "AbortError") throw error;
    throw new ApiError("The server does not answer. Is `conetl view` still running?", 0);
  }
  if (response.ok) return response;
  let detail = `The server answered ${response.status}.`;
  let body: unknown = null;
  try {
    body = await response.json();
    if (typeof body === "object" && body !== null && "detail" in body && typeof body.detail === "string") detail = body.detail;
  } catch {
    // not JSON: the status says it
  }
  throw new ApiError(detail, response.status, body);
}

/** Asked for before the scene is set up, which takes a while; each answer is used once. */
const early = new Map<string, Promise<unknown>>();

async function askJson<T>(path: string, init: RequestInit = {}): Promise<T> {
  const asked = early.get(path);
  if (asked) {
    early.delete(path);
    return (await asked) as T;
  }
  return (await (await ask(path, init)).json()) as T;
}

const enc = encodeURIComponent;

function query(values: Record<string, string | null>): string {
  const search = new URLSearchParams();
  for (const [name, value] of Object.entries(values)) if (value !== null) search.set(name, value);
  const text = search.toString();
  return text ? `?${text}` : "";
}

/** An instant on the road and one of the database; null means the latest. */
export interface Instant {
  valid: string | null;
  known: string | null;
}

/** Ask now for what the first picture of this map needs; `maps` is given back to who asks for it next. */
export function askEarly(map: string, maps: unknown): void {
  early.set("maps", Promise.resolve(maps));
  for (const part of ["timeline", "decisions", "base", "base/lines"]) {
    const path = `maps/${enc(map)}/${part}`;
    const answer = askJson(path);
    answer.catch(() => undefined); // told to who asks for it
    early.set(path, answer);
  }
}

export const api = {
  maps: () => askJson<{ maps: MapItem[]; chosen: string }>("maps"),
  timeline: (map: string) => askJson<Timeline>(`maps/${enc(map)}/timeline`),
  features: (map: string, at: Instant) =>
    askJson<{ features: Feature[]; truncated: boolean }>(
      `maps/${enc(map)}/features${query({ valid_at: at.valid, known_at: at.known })}`,
    ),
  changes: (map: string, changesetNo: number) =>
    askJson<{ changes: Change[]; truncated: boolean }>(`maps/${enc(map)}/changes/${changesetNo}`),
  between: (map: string, from: Instant, to: Instant) =>
    askJson<{ changes: Change[]; truncated: boolean }>(
      `maps/${enc(map)}/changes${query({
        from_valid_at: from.valid,
        from_known_at: from.known,
        to_valid_at: to.valid,
        to_known_at: to.known,
      })}`,
    ),
  history: (map: string, id: string) => askJson<{ history: HistoryItem[] }>(`maps/${enc(map)}/features/${enc(id)}`),
  sightings: (map: string, id: string) =>
    askJson<{ sightings: Sighting[]; truncated: boolean }>(`maps/${enc(map)}/features/${enc(id)}/sightings`),
  trajectory: (map: string, drive: string) => askJson<Trajectory>(`maps/${enc(map)}/drives/${enc(drive)}/trajectory`),
  find: (map: string, beginning: string) =>
    askJson<{ feature_ids: string[]; truncated: boolean }>(`maps/${enc(map)}/find${query({ beginning })}`),
  picture: async (map: string, s: Sighting, side: "left" | "right", whole: boolean, signal: AbortSignal): Promise<Blob> => {
    const place = `maps/${enc(map)}/drives/${enc(s.drive_uuid)}/pictures/${s.frame_index}/${s.match_index}/${side}.jpg`;
    return (await ask(`${place}?context=${whole ? 100 : 3}`, { signal })).blob();
  },
  base: (map: string) => askJson<{ layers: BaseLayer[]; tiles: BaseTile[]; truncated: boolean }>(`maps/${enc(map)}/base`),
  baseLines: (map: string) => askJson<{ lines: BaseLine[]; truncated: boolean }>(`maps/${enc(map)}/base/lines`),
  baseTile: async (map: string, sha256: string): Promise<ArrayBuffer> =>
    (await ask(`maps/${enc(map)}/base/tiles/${enc(sha256)}.bin`)).arrayBuffer(),
  decisions: (map: string) => askJson<Decisions>(`maps/${enc(map)}/decisions`),
  decide: (map: string, wish: Wish, token: string) =>
    askJson<Decided>(`maps/${enc(map)}/decisions`, {
      method: "POST",
      headers: { "Content-Type": "application/json", Authorization: `Bearer ${token}` },
      body: JSON.stringify(wish),
    }),
  events: (map: string) => new EventSource(`./api/maps/${enc(map)}/events`),
};
