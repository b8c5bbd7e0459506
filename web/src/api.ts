// Requests and answers of the server. Their types are those of its OpenAPI document, which `make web` writes into schema.ts.
import type { components } from "./schema";

type Schemas = components["schemas"];
export type Vec3 = Schemas["Feature"]["xyz_m"];
export type ChangeKind = Schemas["Change"]["kind"];
export type MapItem = Schemas["MapItem"];
export type BaseMapItem = Schemas["BaseMapItem"];
/** The document of the server states lists; these are pairs. */
export type Projection = Schemas["MapProjection"] & Record<"centre_m" | "unit_per_degree", [number, number]> & Record<"to_degrees" | "to_metres", [number[], number[]]>;
export type TimelineItem = Schemas["TimelineItem"];
export type Timeline = Schemas["Timeline"];
export type Feature = Schemas["Feature"];
export type Marking = Schemas["MarkingShape"];
export type Change = Schemas["Change"];
export type TileAnswer = Schemas["FeatureTile"];
export type Cluster = Schemas["Cluster"];
export type Summary = Schemas["Summary"] & { origin_m: Vec3; box_m: [number, number, number, number] | null };
export type ChangeCluster = Schemas["ChangeCluster"];
export type ChangesInView = Schemas["ChangesInView"];
export type HistoryItem = Schemas["HistoryItem"];
export type Sighting = Schemas["Sighting"];
export type Trajectory = Schemas["Trajectory"];
export type BaseLayer = Schemas["BaseLayer"];
export type BaseTile = Schemas["BaseTile"];
export type BaseLine = Schemas["BaseLine"];
export type WorkZone = Schemas["WorkZoneArea"];
export type DifferenceRow = Schemas["DifferenceRow"];
export type FoundPosition = Schemas["FoundPosition"];
export type Side = "left" | "right";
export type PassFrame = Schemas["PassFrame"];
export type DrivePass = Schemas["DrivePass"];
export type FrameView = Schemas["FrameView"];
export type Frame = Schemas["Frame"];
export type ReviewItem = Schemas["ReviewItem"];
export type ReviewKind = ReviewItem["kind"];
export type Found = Schemas["SearchResult"];
export type Decision = Schemas["Decision"];
export type Decisions = Schemas["ActiveDecisions"];
export type DecisionRequest = Schemas["PlaceRequest"] | Schemas["ClassRequest"] | Schemas["ApproveRequest"] | Schemas["DriveRequest"] | Schemas["WithdrawRequest"];

/** As lists of drives and imported maps name it. */
export const changesetName = (t: Pick<TimelineItem, "drive_id" | "kind">): string => (t.kind === "drive" ? t.drive_id : `${t.drive_id} (imported map)`);

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

let logIn: (() => Promise<void>) | null = null;
/** What asks the person for the token when the server requires a login again; requests wait for it. */
export const onLoginRequired = (ask: typeof logIn): void => void (logIn = ask);

export async function ask(path: string, init: RequestInit = {}): Promise<Response> {
  const response = await send(path, init);
  // A missing writer token is answered where the decision is written.
  if (response.status !== 401 || !logIn || !response.headers.get("WWW-Authenticate")?.includes("realm")) return accepted(response);
  await logIn();
  return accepted(await send(path, init));
}

/** Exchange the token for the cookie of a login; false if it is wrong. */
export const login = async (token: string): Promise<boolean> => (await send(`maps${query({ token })}`, {})).ok;

async function send(path: string, init: RequestInit): Promise<Response> {
  try {
    return await fetch(`./api/${path}`, init);
  } catch (error) {
    if (error instanceof DOMException && error.name === "AbortError") throw error;
    throw new ApiError("The server does not answer. Check that `conetl view` is running, then try again.", 0);
  }
}

/** What an answer says is wrong: in words, or of each parameter. */
export function detailOf(body: unknown): string | null {
  const detail = (body as { detail?: string | { loc: string[]; msg: string }[] } | null)?.detail;
  return Array.isArray(detail) ? detail.map(({ loc, msg }) => `${loc.at(-1)}: ${msg}`).join("; ") : (detail ?? null);
}

async function accepted(response: Response): Promise<Response> {
  if (response.ok) return response;
  let detail = `The server answered ${response.status}.`;
  let body: unknown = null;
  try {
    body = await response.json();
    detail = detailOf(body) ?? detail;
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

/** Parameters of a request; null is left out, a list is given value by value. */
export type Query = Record<string, string | string[] | null>;

export function query(values: Query): string {
  const given = Object.entries(values).flatMap(([name, value]) => (value === null ? [] : [value].flat().map((one) => [name, one])));
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

/** A person needs no token; an empty one would replace the password that the browser sends. */
const posted = (body: unknown, token: string): RequestInit => ({
  method: "POST",
  headers: { "Content-Type": "application/json", ...(token && { Authorization: `Bearer ${token}` }) },
  body: JSON.stringify(body),
});

export const api = {
  maps: () => askJson<Schemas["Maps"]>("maps"),
  projection: (map: string, [x, y]: [number, number]) => askMap<Projection>(map, `projection${query({ x_m: String(x), y_m: String(y) })}`),
  timeline: (map: string) => askMap<Timeline>(map, "timeline"),
  summary: (map: string, at: Instant) => askMap<Summary>(map, `summary${query({ valid_at: at.valid, known_at: at.known })}`),
  /** `key`: zoom/x/y. */
  tile: (map: string, key: string, at: Instant) => askMap<TileAnswer>(map, `tiles/${key}${query({ valid_at: at.valid, known_at: at.known })}`),
  featurePage: (map: string, of: Query) => askMap<Schemas["FeaturePage"]>(map, `features${query(of)}`),
  changePage: (map: string, of: Query) => askMap<Schemas["ChangePage"]>(map, `changes${query(of)}`),
  /** Number of rows of a list, and the index of one feature in it. */
  listCount: (map: string, list: "features" | "changes", of: Query) => askMap<Schemas["ListCount"]>(map, `${list}/count${query(of)}`),
  changeSummary: (map: string, of: Query) => askMap<Schemas["ChangeSummary"]>(map, `changes/summary${query(of)}`),
  changesInView: (map: string, of: Query) => askMap<ChangesInView>(map, `changes/view${query(of)}`),
  history: (map: string, id: string, known: string | null) => askMap<Schemas["FeatureHistory"]>(map, `features/${id}${query({ known_at: known })}`),
  sightings: (map: string, id: string) => askMap<Schemas["Sightings"]>(map, `features/${id}/sightings`),
  trajectory: (map: string, drive: string) => askMap<Trajectory>(map, `drives/${drive}/trajectory`),
  search: (map: string, text: string) => askMap<Found>(map, `search${query({ text })}`),
  /** Address of a file of the state that is shown; empty values are left out. */
  download: (map: string, format: string, values: Query) => `./api/${mapPath(map, `downloads/${format}${query(values)}`)}`,
  report: (map: string, changesetNo: number) => `./api/${mapPath(map, `changesets/${changesetNo}/report`)}`,
  zones: (map: string, valid: string | null) => askMap<Schemas["WorkZoneAreas"]>(map, `work-zones${query({ valid_at: valid })}`),
  differences: (map: string) => askMap<Schemas["Differences"]>(map, "differences"),
  judge: (map: string, id: string, said: Schemas["VerdictRequest"], token: string) => askMap<Schemas["DifferenceVerdict"]>(map, `differences/${id}`, posted(said, token)),
  base: (map: string) => askMap<Schemas["BaseLayers"]>(map, "base"),
  baseLines: (map: string) => askMap<Schemas["BaseLines"]>(map, "base/lines"),
  baseTile: async (map: string, sha256: string): Promise<ArrayBuffer> => (await ask(mapPath(map, `base/tiles/${sha256}.bin`))).arrayBuffer(),
  passes: (map: string, id: string, version: number | null) => askMap<Schemas["Passes"]>(map, `features/${id}/passes${query({ version: version === null ? null : String(version) })}`),
  frame: (map: string, drive: string, index: number) => askMap<Frame>(map, `drives/${drive}/frames/${index}`),
  image: async (map: string, drive: string, index: number, side: Side, feature: string | null): Promise<Blob> =>
    (await ask(mapPath(map, `drives/${drive}/frames/${index}/${side}.jpg${query({ feature_id: feature })}`))).blob(),
  review: (map: string, offset: number, limit: number) => askMap<Schemas["Review"]>(map, `review${query({ offset: String(offset), limit: String(limit) })}`),
  decisions: (map: string) => askMap<Decisions>(map, "decisions"),
  decide: (map: string, request: DecisionRequest, token: string) =>
    askMap<Schemas["Decided"]>(map, "decisions", posted(request, token)),
  events: (map: string) => new EventSource(`./api/${mapPath(map, "events")}`),
};
