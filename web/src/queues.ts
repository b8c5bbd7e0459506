// What is reviewed: drives and changes, and differences between planned and found work zones; with the answers to each.
import { api, type DecisionRequest, type DifferenceRow, type ReviewItem, type ReviewKind } from "./api";
import { CLASSES, classOf } from "./classes";
import { shortId, sureText, utc } from "./dom";
import type { Answer, By, Queue } from "./review";

const PAGE = 100;
type Actions<T> = Pick<Queue<T>, "show" | "subject" | "decided"> & { map(): string };

// --- drives and changes

interface Meaning {
  text: string;
  done: string;
  request(item: ReviewItem, by: By): DecisionRequest;
}
const about = (i: ReviewItem) => ({ feature_id: i.feature_id ?? "", expected_version: i.version ?? 0 });
const place = (kind: "pin" | "suppress", text: string, done: string): Meaning => ({ text, done, request: (i, by) => ({ kind, radius_m: 1, ...about(i), ...by }) });
const approve = (text: string, done: string): Meaning => ({ text, done, request: (i, by) => ({ kind: "approve", ...about(i), ...by }) });
const drive = (kind: "accept" | "revert", text: string, done: string): Meaning => ({ text, done, request: (i, by) => ({ kind, changeset_id: i.changeset_id ?? "", ...by }) });
const ofClass = (category: string): Meaning => {
  const text = classOf(category).label;
  return { text, done: text.toLowerCase(), request: (i, by) => ({ kind: "classify", category, ...about(i), ...by }) };
};
const KINDS: Record<ReviewKind, { heading: string; question: string; accept: Meaning; reject: Meaning }> = {
  held: { heading: "Drives on hold", question: "May this drive change the map?", accept: drive("accept", "it may", "accepted"), reject: drive("revert", "leave it out", "left out") },
  removal: { heading: "Removed cones", question: "Is this cone gone?", accept: approve("it is gone", "gone"), reject: place("pin", "it still stands", "still stands") },
  move: { heading: "Moved by 1 m or more", question: "Does the cone stand here now?", accept: approve("it stands here", "moved"), reject: place("suppress", "no cone here", "no cone") },
  doubtful: { heading: "Uncertain cones", question: "Does a cone stand here?", accept: place("pin", "it stands", "stands"), reject: place("suppress", "no cone here", "no cone") },
};

export function changeQueue(actions: Actions<ReviewItem> & { decidesDrives(): boolean }): Queue<ReviewItem> {
  const answer = (item: ReviewItem, key: string, verb: string, text: string, { done, request }: Meaning): Answer => ({
    key, verb, text, done,
    async write(by, token) {
      const map = actions.map();
      const { decision_id, versions_written } = await api.decide(map, request(item, by), token);
      return { undo: decision_id ? (again, later) => api.decide(map, { kind: "withdraw", decision_id, ...again }, later) : null, changed: versions_written > 0 };
    },
  }); // prettier-ignore
  return {
    ...actions, id: "review", name: "Review", title: "Drives and changes to review, in images", reason: "judged in the images",
    async read(map, offset) {
      const { items, counts } = await api.review(map, offset, PAGE);
      return { items, total: Object.values(counts).reduce((a, b) => a + b, 0) };
    },
    card: (i) => ({
      key: `${i.kind} ${i.feature_id ?? i.changeset_id ?? ""} ${i.changeset_no}`, version: String(i.version), ...KINDS[i.kind],
      name: i.feature_id ? shortId(i.feature_id) : i.drive_id, isId: i.feature_id !== null, judged: "",
      about: i.checks[0]?.name ?? `${i.drive_id} · ${utc(i.at, false)} UTC`,
      why: [i.why, i.checks.filter((c) => c.figures).map((c) => `${c.name}: ${c.figures}`).join("; ")].filter(Boolean).join(" Measured: "),
    }),
    answers: (i) => [answer(i, "A", "Accept:", KINDS[i.kind].accept.text, KINDS[i.kind].accept), answer(i, "R", "Reject:", KINDS[i.kind].reject.text, KINDS[i.kind].reject)],
    classes: (i) => (i.feature_id === null || i.kind === "removal" ? [] : [...CLASSES.keys()].filter((c) => c !== "lane_marking" && c !== i.category).map((c, n) => answer(i, String(n + 1), classOf(c).label, "", ofClass(c)))),
    refuses: (i) => (i.kind === "held" && !actions.decidesDrives() ? "Decisions about whole drives require the role admin." : null),
  }; // prettier-ignore
}

// --- differences from plans

type Said = DifferenceRow["verdict"];
const SAID: [Said, string, string, string][] = [
  ["confirmed", "C", "Confirm:", "it differs"],
  ["accepted", "A", "Accept:", "it may stay so"],
  ["wrong", "W", "Wrong:", "it does not differ"],
  ["open", "O", "Open again", ""],
];
const sentence = (text: string) => `${text.charAt(0).toUpperCase()}${text.slice(1)}`;
const percent = (share: number) => `${Math.round(100 * share)} %`;

/** `rows`: what was read, for the layer. */
export function differenceQueue(actions: Actions<DifferenceRow> & { rows(rows: DifferenceRow[], planCount: number): void }): Queue<DifferenceRow> {
  const answer = (row: DifferenceRow, [verdict, key, verb, text]: (typeof SAID)[number]): Answer => ({
    key, verb, text, done: verdict,
    async write({ decided_by, reason: note }, token) {
      const map = actions.map();
      const say = (said: Said, by: string, why: string, with_: string) => api.judge(map, row.difference_id, { verdict: said, decided_by: by, note: why }, with_);
      await say(verdict, decided_by, note, token);
      return { undo: (again, later) => say(row.verdict, again.decided_by, again.reason, later), changed: false };
    },
  }); // prettier-ignore
  return {
    ...actions, id: "differences", name: "Plans", title: "Work zones that differ from their plans, in images", reason: "",
    async read(map) {
      const { rows, plan_count } = await api.differences(map);
      actions.rows(rows, plan_count);
      const items = rows.filter((row) => row.rank !== null);
      return { items, total: items.length };
    },
    card: (r) => ({
      key: r.difference_id, version: JSON.stringify(passesOf(r)), question: sentence(r.kind),
      heading: r.verdict !== "open" ? "Judged" : r.last_night ? "Last night" : "Earlier",
      name: sentence(r.kind), isId: false, judged: r.verdict === "open" ? "" : r.verdict, about: `${placeOf(r)} · ${r.text}`, why: whyOf(r),
    }),
    answers: (r) => SAID.filter(([verdict]) => verdict !== r.verdict).map((one) => answer(r, one)),
    classes: () => [],
    refuses: () => null,
  }; // prettier-ignore
}

/** The frame pairs of the last pass that found the zone, or looked, and of the first one, if another drive's. */
export function passesOf(r: DifferenceRow) {
  const passes = [r.last, r.first].flatMap((s) => (s?.drive_uuid && s.frame_index !== null && s.frame_index !== undefined ? [{ drive_uuid: s.drive_uuid, frame_index: s.frame_index, drive_id: s.drive_id ?? "", at: s.at }] : []));
  return passes.filter((pass, i) => passes.findIndex((other) => other.drive_uuid === pass.drive_uuid) === i);
}

const placeOf = (r: DifferenceRow) => (r.plan_id == null ? `zone ${shortId(r.zone_id ?? "")}` : `plan ${r.plan_id}`);

function whyOf(r: DifferenceRow): string {
  const until = (from?: string | null, to?: string | null) => `${from ? utc(from, false) : "…"} to ${to ? utc(to, false) : "open"} UTC`;
  return [
    `${sentence(placeOf(r))}: ${r.text}${r.sigma == null ? "" : ` (± ${r.sigma.toFixed(2)} m)`}.`,
    r.planned_from && `Planned ${until(r.planned_from, r.planned_until)}.`,
    r.from_at && r.zone_id && `Seen from ${utc(r.from_at, false)} UTC, ${r.until_at ? `gone at ${utc(r.until_at, false)} UTC` : r.passed_at ? `last at ${utc(r.passed_at, false)} UTC` : "open"}.`,
    r.zone_id && typeof r.coverage === "number" && r.coverage < 1 && `${r.coverage ? `Drives passed ${percent(r.coverage)} of` : "No drive passed"} the place of the plan in its time.`,
    `Sure that it differs: ${sureText(r.confidence)}.`,
    r.verdict !== "open" && `${sentence(r.verdict)}${r.decided_by ? ` by ${r.decided_by}` : ""}${r.note ? `: ${r.note}` : ""}.`,
  ].filter(Boolean).join(" "); // prettier-ignore
}

export const differenceWords = (r: DifferenceRow): string => `${sentence(r.kind)}${r.amount == null ? "" : ` · ${r.amount.toFixed(r.unit === "h" ? 1 : 0)} ${r.unit}`}`;
