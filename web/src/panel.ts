// Right: details of the selected cone.
import type { Decisions, HistoryItem, Marking, Sighting } from "./api";
import { classOf, nounOf } from "./classes";
import { aboutFeature, createDecider, placeChoice, sentence, withdrawChoice, type DecideContext } from "./decisions";
import { el, fill, knownText, lengthText, messageOf, plural, probabilityText, shortId, sureText, when } from "./dom";
import { icon, isGone, STYLES, type Kind } from "./kinds";
import { lengthOf, wordsOf } from "./markings";
import { ellipse95, niceFactor } from "./overlays";

export interface PanelActions {
  close(): void;
  showChangeset(no: number): void;
  setFactor(factor: number | null): void;
  centre(): void;
  decided(): void;
}

export interface Chosen {
  id: string;
  map: string;
  srid: number;
  history: HistoryItem[];
  /** Instant of the database; null is now. */
  known: string | null;
  /** null while they are being fetched. */
  sightings: Sighting[] | null;
  /** Whether a change had happened in the state that is shown. */
  reached: (h: HistoryItem) => boolean;
  /** As the scene draws it; null where it shows no cone. */
  kind: Kind | null;
  /** Enlargement of the ellipse; null chooses one. */
  factor: number | null;
  /** null while they are being fetched. */
  decisions: Decisions | null;
}

const accuracy = (variance: number) => `±${lengthText(Math.sqrt(variance))}`;
const [SURE, ACCURACY] = ["Existence probability", "One standard deviation (sigma)"];

/** The state that is shown; undefined before the cone was on the map. */
export const stateOf = ({ history, reached }: Chosen): HistoryItem | undefined => history.filter(reached).at(-1);

export function createPanel(host: HTMLElement, actions: PanelActions) {
  const head = el("header", {});
  const facts = el("div", {});
  const decided = el("div", {});
  const deciderHost = el("div", {});
  const decide = el("section", { class: "decide-section" }, el("h3", { textContent: "Decision" }), decided, deciderHost);
  const decider = createDecider(deciderHost);
  const story = el("section", {});
  const images = el("section", { class: "panel-images", aria: { label: "Images" } });
  const reason = el("div", {});
  const scroll = el("div", { class: "panel-scroll" }, images, reason, facts, decide, story);
  host.append(head, scroll);

  function setHead(id: string, ...chips: Node[]): void {
    const copy = el("button", { type: "button", class: "link", textContent: "Copy id" });
    copy.addEventListener("click", () => {
      void navigator.clipboard.writeText(id).then(() => (copy.textContent = "Copied"), () => (copy.textContent = "Not allowed by the browser")); // prettier-ignore
    });
    fill(
      head,
      el("div", { class: "panel-title" }, ...chips, el("h2", { class: "mono", textContent: shortId(id), title: id }), copy,
        el("button", { type: "button", class: "link", textContent: "Centre", onclick: () => actions.centre() })),
      el("button", { type: "button", class: "close", textContent: "×", title: "Close (Esc)", aria: { label: "Close" }, onclick: () => actions.close() }),
    ); // prettier-ignore
  }

  /** A message in place of the details. */
  function message(id: string, text: string, style: string): void {
    host.hidden = false;
    setHead(id);
    decide.hidden = true;
    fill(facts);
    fill(reason, el("p", { class: `hint ${style}`, textContent: text }));
    fill(story);
  }

  function show(chosen: Chosen): void {
    host.hidden = false;
    const first = chosen.history[0];
    if (!first) return;
    const now = stateOf(chosen);
    const kind = chosen.kind ?? now?.kind;
    const about = aboutFeature(chosen.decisions?.decisions ?? [], chosen.id, chosen.history.at(-1)?.xyz_m, Boolean(first.marking));
    setHead(chosen.id, kind ? el("span", { class: "chip kind" }, icon(kind), STYLES[kind].label) : el("span", { class: "chip kind", textContent: "not on the map yet" }),
      ...(about.some((d) => d.kind === "pin") ? [el("span", { class: "chip pinned", textContent: "pinned" })] : [])); // prettier-ignore
    fill(reason, now && sentenceOf(now));
    fill(facts);
    if (now) showFacts(chosen, now);
    else fill(reason, el("p", { class: "notice", textContent: `Not on the map yet: ${first.drive_id}, recorded ${when(first.captured_from)}, added it.` }));
    showDecisions(chosen);
    showStory(chosen, now);
  }

  function showFacts(chosen: Chosen, now: HistoryItem): void {
    const e = ellipse95(now.cov_m2);
    const auto = niceFactor(e);
    const factor = el("select", { aria: { label: "Scale of the drawn ellipse" } },
      el("option", { value: "auto", textContent: `${auto}× (auto)` }), ...[1, 10, 100].map((f) => el("option", { value: String(f), textContent: `${f}×` }))); // prettier-ignore
    factor.value = chosen.factor === null ? "auto" : String(chosen.factor);
    factor.addEventListener("change", () => actions.setFactor(factor.value === "auto" ? null : Number(factor.value)));
    const meter = el("span", { class: "meter" }, el("i"));
    (meter.firstElementChild as HTMLElement).style.width = `${now.existence_probability * 100}%`;
    const line = now.marking;
    const [easting, northing, height] = now.map_xyz_m.map((v) => v.toFixed(3));
    fill(
      facts,
      isGone(now.kind) && el("p", { class: "hint", textContent: "Last values before it left the map:" }),
      el(
        "dl", {},
        ...row("Class", classOf(now.category).label),
        ...row("Position", el("span", { class: "mono", textContent: `${easting} E` }), el("span", { class: "mono", textContent: `${northing} N` }), el("small", { textContent: `EPSG:${chosen.srid}, ${line ? "middle of this stretch" : "foot centre"}` })),
        ...row("Height", el("span", { class: "mono", textContent: `${height} m` }), el("small", { textContent: "ellipsoidal" })),
        ...row("Accuracy", el("span", { title: `${ACCURACY}: ${[0, 3, 5].map((i) => Math.sqrt(now.cov_m2[i] ?? 0).toFixed(3)).join(", ")} m`, textContent: `${accuracy(now.cov_m2[0])} east, ${accuracy(now.cov_m2[3])} north, ${accuracy(now.cov_m2[5])} up` })),
        ...(line ? lineRows(line) : row("95 % semi-axes", el("span", { class: "mono", textContent: `${e.major_m.toFixed(3)} × ${e.minor_m.toFixed(3)} m` }),
          el("small", {}, "ellipse drawn at ", factor))),
        ...row("Sure it stands", meter, el("span", { title: `${SURE} ${probabilityText(now.existence_probability)}`, textContent: sureText(now.existence_probability) })),
        ...row("Evidence", el("span", { textContent: evidence(now) }), el("small", { textContent: `${plural(now.observation_count, "observation")} in total` })),
        ...(now.object_height_m === null ? [] : row("Object height", el("span", { class: "mono", textContent: `${now.object_height_m.toFixed(3)} ± ${(now.object_height_sigma_m ?? 0).toFixed(3)} m` }))),
        ...row("First, last seen", el("span", { textContent: when(now.first_seen_at, false) }), el("span", { textContent: when(now.last_seen_at, false) })),
      ),
    ); // prettier-ignore
  }

  function showDecisions({ id, map, history, decisions }: Chosen): void {
    const newest = history.at(-1);
    decide.hidden = decisions === null || !newest || (!decisions.writable && !aboutFeature(decisions.decisions, id, newest.xyz_m, Boolean(newest.marking)).length);
    if (!decisions || !newest) return;
    const about = aboutFeature(decisions.decisions, id, newest.xyz_m, Boolean(newest.marking));
    fill(decided, ...about.map(sentence));
    if (!decisions.writable) return decider.show(`${id} reading`, [], { map, changed: () => undefined });
    const noun = nounOf(newest.category);
    const has = (kind: string) => about.some((d) => d.kind === kind);
    const context: DecideContext = { map, changed: () => actions.decided() };
    decider.show(`${id} ${newest.version} ${about.map((d) => d.decision_id).join(" ")}`, [
      ...(has("suppress") || isGone(newest.kind) ? [] : [placeChoice("suppress", id, newest.version, noun)]),
      ...(has("pin") || has("suppress") ? [] : [placeChoice("pin", id, newest.version, noun)]),
      ...about.map(withdrawChoice),
    ], context); // prettier-ignore
  }

  function showStory(chosen: Chosen, now: HistoryItem | undefined): void {
    fill(
      story,
      el("h3", { textContent: `History, ${knownText(chosen.known)}` }),
      el("ol", { class: "history" }, ...chosen.history.map((h) =>
        el("li", { class: h === now ? "chosen" : "" },
          el("button", { type: "button", title: h.why, onclick: () => actions.showChangeset(h.changeset_no) },
            icon(h.kind),
            el("span", {}, el("b", { textContent: STYLES[h.kind].label }), h.kind === "moved" && h.shift_m !== null && ` by ${h.shift_m.toFixed(3)} m`, other(h), h.kind === "missed" ? frames(h) : ` · version ${h.version}`,
              el("small", {}, `${when(h.changed_at)} · `, el("span", { class: "together", textContent: h.drive_id })),
              el("small", { title: `${SURE} ${probabilityText(h.existence_probability)}`, textContent: `sure it stands: ${sureText(h.existence_probability)} · ${plural(h.observation_count, "observation")} · ${accuracy((h.cov_m2[0] + h.cov_m2[3]) / 2)}` }))))),
      ),
    ); // prettier-ignore
  }

  function hide(): void {
    host.hidden = true;
  }

  return {
    images, show, hide,
    loading: (id: string) => message(id, "Loading the history …", "loading"),
    failed: (id: string, error: unknown) => message(id, messageOf(error), "bad"),
  };
}

function sentenceOf(now: HistoryItem): HTMLElement {
  return el("p", { class: isGone(now.kind) || now.kind === "missed" ? "why gone" : "why", textContent: now.why });
}

function row(name: string, ...values: (Node | string)[]): Node[] {
  return [el("dt", { textContent: name }), el("dd", {}, ...values)];
}

const lineRows = (line: Marking): Node[] => [
  ...row("Accuracy across", el("span", { title: ACCURACY, textContent: `±${lengthText(line.sigma_lateral_m)}` }), el("small", { textContent: "largest along the line" })),
  ...row("Paint", el("span", { textContent: wordsOf(line) })),
  ...row("Width", el("span", { class: "mono", textContent: `${line.width_m.toFixed(3)} ± ${line.width_sigma_m.toFixed(3)} m` })),
  ...row("Length", el("span", { class: "mono", textContent: `${lengthOf(line.line_m).toFixed(2)} m` }), el("small", { textContent: "of this stretch" })),
]; // prettier-ignore

/** "observed by 3 drives, not observed by 1 drive", broken only at the comma. */
function evidence(h: HistoryItem): string {
  const missed = h.missed_count ? [`not observed by ${plural(h.missed_count, "drive")}`] : [];
  return [`observed by ${h.seen_count ? plural(h.seen_count, "drive") : "no drive"}`, ...missed].map((part) => part.replaceAll(" ", "\u00a0")).join(", ");
}

const frames = (h: HistoryItem): string => (h.frames_empty ? ` in ${plural(h.frames_empty, "frame pair")}` : "");

/** The other cone of a split or merger. */
function other(h: HistoryItem): string {
  if (h.other_feature_id === null) return "";
  return ` ${h.kind === "merged" ? "into" : "from"} ${shortId(h.other_feature_id)}`;
}
