// Requests and answers of the server (src/conetl/web/models.py). Lengths in metres, positions as offsets from origin_m.

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

/** Tiles under the map, in the Web Mercator scheme of XYZ. */
export interface BaseMapItem {
  template: string;
  attribution: string;
  max_zoom: number;
}

/** Polynomials between the map's CRS and WGS 84 (src/conetl/web/models.py). */
export interface Projection {
  centre_m: [number, number];
  radius_m: number;
  lon_deg: number;
  lat_deg: number;
  degree: number;
  unit_per_degree: [number, number];
  to_degrees: [number[], number[]];
  to_metres: [number[], number[]];
}

export interface TimelineItem {
  changeset_no: number;
  changeset_id: string;
  /** Of an import, the name of the map. */
  drive_id: string;
  kind: "drive" | "import";
  drive_uuid: string;
  captured_from: string;
  captured_to: string;
  valid_at: string;
  committed_at: string;
  /** When its changes came to the map: the commit, or the release from hold. */
  effective_at: string;
  known_before: string;
  added_count: number;
  confirmed_count: number;
  moved_count: number;
  removed_count: number;
  missed_count: number;
  height_changed_count: number;
  split_count: number;
  merged_count: number;
  /** Changes of stretches of lane markings; the counts above are of objects. */
  line_counts: Partial<Record<ChangeKind, number>>;
  frame_pair_count: number;
  rejection_count: number;
  /** False if it was reverted, or a later analysis of the same recording replaced it. */
  counts: boolean;
  /** Why it is on hold; null unless it is. */
  hold: string | null;
}

/** As lists of drives and imported maps name it. */
export const changesetName = (t: Pick<TimelineItem, "drive_id" | "kind">): string => (t.kind === "drive" ? t.drive_id : `${t.drive_id} (imported map)`);

export interface Timeline {
  map_name: string;
  srid: number;
  origin_m: Vec3;
  changesets: TimelineItem[];
}

export interface Feature {
  feature_id: string;
  version: number;
  category: string;
  xyz_m: Vec3;
  cone_height_m: number;
  existence_probability: number;
  observation_count: number;
  /** Horizontal, along the major axis of the error ellipse. */
  sigma_m: number;
  last_seen_at: string;
  /** Of the changeset that wrote this version. */
  changeset_no: number;
}

/** Shape of a stretch of a lane marking; the position of its feature is the middle vertex. */
export interface Marking {
  line_m: Vec3[];
  width_m: number;
  width_sigma_m: number;
  colour: "white" | "yellow" | "other";
  pattern: "solid" | "dashed";
  dash_m: number | null;
  gap_m: number | null;
  /** Across the line. */
  sigma_lateral_m: number;
}

export interface Stretch extends Feature {
  marking: Marking;
}

export interface Change extends Feature {
  kind: ChangeKind;
  shift_m: number | null;
  old_xyz_m: Vec3 | null;
}

export interface StretchChange extends Change {
  marking: Marking;
  old_marking: Marking | null;
}

export interface Features {
  features: Feature[];
  markings: Stretch[];
  truncated: boolean;
}

export interface Changes {
  changes: Change[];
  markings: StretchChange[];
  truncated: boolean;
}

export interface HistoryItem extends Omit<Change, "feature_id" | "old_xyz_m" | "sigma_m"> {
  changeset_no: number;
  drive_id: string;
  drive_uuid: string;
  captured_from: string;
  changed_at: string;
  other_feature_id: string | null;
  frames_empty: number | null;
  map_xyz_m: Vec3;
  cov_m2: [number, number, number, number, number, number];
  cone_height_sigma_m: number;
  first_seen_at: string;
  last_seen_at: string;
  sighting_count: number;
  /** Of lane markings. */
  marking: Marking | null;
  /** Drives that observed it, and that did not although it was visible, up to this one. */
  seen_count: number;
  missed_count: number;
  /** What happened, in one sentence with numbers. */
  why: string;
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
  frame_index: number[];
  captured_at: string[];
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

export interface FoundPosition {
  label: string;
  /** Offset from the map's origin. */
  xy_m: [number, number];
  lat_lon_deg: [number, number] | null;
}

/** What a searched text may mean. */
export interface Found {
  feature_ids: string[];
  drives: Pick<TimelineItem, "changeset_no" | "drive_id" | "kind" | "captured_from">[];
  positions: FoundPosition[];
  places: FoundPosition[];
  truncated: boolean;
}

/** A decision in effect. */
export interface Decision {
  decision_id: string;
  kind: "suppress" | "pin" | "classify" | "revert" | "accept" | "hold";
  /** Centre of the area with the radius radius_m. */
  xy_m: [number, number] | null;
  radius_m: number | null;
  feature_id: string | null;
  changeset_id: string | null;
  drive_id: string | null;
  /** Whether it is about lane markings. */
  of_line: boolean;
  /** Of classify: the class that drives detect ... */
  found_as: string | null;
  /** ... and the one that the person gives it. */
  category: string | null;
  decided_by: string | null;
  reason: string;
  decided_at: string;
}

export interface Decisions {
  /** Whether this server accepts decisions from holders of its writer token. */
  writable: boolean;
  decisions: Decision[];
}

export interface Decided {
  decision_id: string;
  versions_written: number;
  replayed: number;
  /** Drives that went on hold, or are on hold no longer, a sentence each. */
  hold_changes: string[];
  /** Why a report on disk could not be written again. */
  report_problem: string | null;
}

export type DecisionRequest = { decided_by: string; reason: string } & (
  | { kind: "suppress" | "pin"; feature_id: string; expected_version: number; radius_m: number }
  | { kind: "revert" | "accept"; changeset_id: string }
  | { kind: "withdraw"; decision_id: string }
);

/** An error with the message of the server; `status` is 0 if it cannot be reached. */
export class ApiError extends Error {
  constructor(
    message: string,
    readonly status: number,
    /** The whole answer, if it was JSON. */
    readonly body: unknown = null,
  ) {
    super(message);
  }
}

export async function ask(path: string, init: RequestInit = {}): Promise<Response> {
  let response: Response;
  try {
    response = await fetch(`./api/${path}`, init);
  } catch (error) {
    if (error instanceof DOMException && error.name === "AbortError") throw error;
    throw new ApiError("The server does not answer. Check that `conetl view` is running, then try again.", 0);
  }
  if (response.ok) return response;
  let detail = `The server answered ${response.status}.`;
  let body: unknown = null;
  try {
    body = await response.json();
    if (typeof body === "object" && body !== null && "detail" in body && typeof body.detail === "string") detail = body.detail;
  } catch {
    // not JSON: the status is the message
  }
  throw new ApiError(detail, response.status, body);
}

/** Requests sent before the scene is set up, which takes a while; each answer is used once. */
const early = new Map<string, Promise<unknown>>();

async function askJson<T>(path: string, init: RequestInit = {}): Promise<T> {
  const sent = early.get(path);
  if (sent) {
    early.delete(path);
    return (await sent) as T;
  }
  return (await (await ask(path, init)).json()) as T;
}

export const mapPath = (map: string, path: string) => `maps/${encodeURIComponent(map)}/${path}`;
export const askMap = <T>(map: string, path: string, init?: RequestInit) => askJson<T>(mapPath(map, path), init);

export function query(values: Record<string, string | null>): string {
  const given = Object.entries(values).filter((entry): entry is [string, string] => entry[1] !== null);
  return given.length ? `?${new URLSearchParams(given).toString()}` : "";
}

/** An instant on the road and one of the database; null means the latest. */
export interface Instant {
  valid: string | null;
  known: string | null;
}

/** Send the requests for the first view of this map now; `maps` answers the next request for it. */
export function requestEarly(map: string, maps: unknown): void {
  early.set("maps", Promise.resolve(maps));
  for (const part of ["timeline", "decisions", "base", "base/lines"]) {
    const path = mapPath(map, part);
    const answer = askJson(path);
    answer.catch(() => undefined); // reported where the answer is used
    early.set(path, answer);
  }
}

export const api = {
  maps: () => askJson<{ maps: MapItem[]; chosen: string; basemap: BaseMapItem | null }>("maps"),
  projection: (map: string, [x, y]: [number, number]) => askMap<Projection>(map, `projection${query({ x_m: String(x), y_m: String(y) })}`),
  timeline: (map: string) => askMap<Timeline>(map, "timeline"),
  features: (map: string, at: Instant) =>
    askMap<Features>(map, `features${query({ valid_at: at.valid, known_at: at.known })}`),
  changes: (map: string, changesetNo: number) => askMap<Changes>(map, `changes/${changesetNo}`),
  between: (map: string, from: Instant, to: Instant) => {
    const instants = { from_valid_at: from.valid, from_known_at: from.known, to_valid_at: to.valid, to_known_at: to.known };
    return askMap<Changes>(map, `changes${query(instants)}`);
  },
  history: (map: string, id: string, known: string | null) => askMap<{ history: HistoryItem[] }>(map, `features/${id}${query({ known_at: known })}`),
  sightings: (map: string, id: string) => askMap<{ sightings: Sighting[]; truncated: boolean }>(map, `features/${id}/sightings`),
  trajectory: (map: string, drive: string) => askMap<Trajectory>(map, `drives/${drive}/trajectory`),
  search: (map: string, text: string) => askMap<Found>(map, `search${query({ text })}`),
  /** Address of a file of the state that is shown; empty values are left out. */
  download: (map: string, format: string, values: Record<string, string | null>) => `./api/${mapPath(map, `downloads/${format}${query(values)}`)}`,
  report: (map: string, changesetNo: number) => `./api/${mapPath(map, `changesets/${changesetNo}/report`)}`,
  image: async (map: string, s: Sighting, side: "left" | "right", whole: boolean, signal: AbortSignal): Promise<Blob> => {
    const path = `drives/${s.drive_uuid}/pictures/${s.frame_index}/${s.match_index}/${side}.jpg?context=${whole ? 100 : 3}`;
    return (await ask(mapPath(map, path), { signal })).blob();
  },
  base: (map: string) => askMap<{ layers: BaseLayer[]; tiles: BaseTile[]; truncated: boolean }>(map, "base"),
  baseLines: (map: string) => askMap<{ lines: BaseLine[]; truncated: boolean }>(map, "base/lines"),
  baseTile: async (map: string, sha256: string): Promise<ArrayBuffer> => (await ask(mapPath(map, `base/tiles/${sha256}.bin`))).arrayBuffer(),
  decisions: (map: string) => askMap<Decisions>(map, "decisions"),
  decide: (map: string, request: DecisionRequest, token: string) =>
    askMap<Decided>(map, "decisions", {
      method: "POST",
      headers: { "Content-Type": "application/json", Authorization: `Bearer ${token}` },
      body: JSON.stringify(request),
    }),
  events: (map: string) => new EventSource(`./api/${mapPath(map, "events")}`),
};
