// Right: details of the selected cone.
import { api, ApiError, type Decisions, type HistoryItem, type Marking, type Sighting } from "./api";
import { classOf, nounOf } from "./classes";
import { aboutFeature, createDecider, placeChoice, sentence, withdrawChoice, type DecideContext } from "./decisions";
import { el, fill, knownText, messageOf, plural, probabilityText, shortId, utc } from "./dom";
import { createEmptyPosition, sentenceOf } from "./explain";
import { icon, isGone, STYLES, type Kind } from "./kinds";
import { lengthOf, wordsOf } from "./markings";
import { ellipse95, niceFactor } from "./overlays";
import type { Start } from "./viewer";

export interface PanelActions {
  close(): void;
  showSighting(index: number): void;
  showChangeset(no: number): void;
  setFactor(factor: number | null): void;
  centre(): void;
  decided(): void;
  /** Open the image viewer, at this frame pair or at the one that shows most. */
  openImages(start: Start | null): void;
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
  truncated: boolean;
  sightingIndex: number;
  /** Whether a change had happened in the state that is shown. */
  reached: (h: HistoryItem) => boolean;
  /** As the scene draws it; null where it shows no cone. */
  kind: Kind | null;
  /** Enlargement of the ellipse; null chooses one. */
  factor: number | null;
  /** null while they are being fetched. */
  decisions: Decisions | null;
}

const scoreText = (box: { score: number | null }) => box.score?.toFixed(2) ?? "none";
const sigma = (variance: number) => Math.sqrt(variance).toFixed(3);

/** The state that is shown; undefined before the cone was on the map. */
export const stateOf = ({ history, reached }: Chosen): HistoryItem | undefined => history.filter(reached).at(-1);

export function createPanel(host: HTMLElement, actions: PanelActions) {
  let whole = false;
  let loadingImages: AbortController | null = null;
  let urls: string[] = [];
  let shownImage = "";
  const head = el("header", {});
  const facts = el("div", {});
  const decided = el("div", {});
  const deciderHost = el("div", {});
  const decide = el("section", { class: "decide-section" }, el("h3", { textContent: "Decision" }), decided, deciderHost);
  const decider = createDecider(deciderHost);
  const story = el("section", {});
  const seen = el("section", { class: "sightings" });
  const emptyHost = el("section", { class: "empty-position", hidden: true });
  const showEmpty = createEmptyPosition(emptyHost, (start) => actions.openImages(start));
  const reason = el("div", {});
  const scroll = el("div", { class: "panel-scroll" }, reason, emptyHost, seen, facts, decide, story);
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
    shownImage = "";
    decide.hidden = emptyHost.hidden = true;
    fill(facts);
    fill(reason, el("p", { class: `hint ${style}`, textContent: text }));
    fill(story);
    fill(seen);
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
    else fill(reason, el("p", { class: "notice", textContent: `Not on the map yet: ${first.drive_id}, recorded ${utc(first.captured_from)} UTC, added it.` }));
    if (now?.marking) emptyHost.hidden = true; // no image shows it alone
    else void showEmpty(chosen.map, chosen.id, now);
    showDecisions(chosen);
    showStory(chosen, now);
    showSightings(chosen);
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
        ...row("Sigma E, N, up", el("span", { class: "mono", textContent: `${sigma(now.cov_m2[0])}, ${sigma(now.cov_m2[3])}, ${sigma(now.cov_m2[5])} m` })),
        ...(line ? lineRows(line) : row("95 % semi-axes", el("span", { class: "mono", textContent: `${e.major_m.toFixed(3)} × ${e.minor_m.toFixed(3)} m` }),
          el("small", {}, "ellipse drawn at ", factor))),
        ...row("Existence probability", meter, el("span", { class: "mono", textContent: probabilityText(now.existence_probability) })),
        ...row("Evidence", el("span", { textContent: evidence(now) }), el("small", { textContent: `${plural(now.observation_count, "observation")} in total` })),
        ...(now.object_height_m === null ? [] : row("Object height", el("span", { class: "mono", textContent: `${now.object_height_m.toFixed(3)} ± ${(now.object_height_sigma_m ?? 0).toFixed(3)} m` }))),
        ...row("First, last seen", el("span", { class: "mono", textContent: utc(now.first_seen_at) }), el("span", { class: "mono", textContent: `${utc(now.last_seen_at)} UTC` })),
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
              el("small", {}, `${utc(h.changed_at)} UTC · `, el("span", { class: "together", textContent: h.drive_id })),
              el("small", { textContent: `existence ${probabilityText(h.existence_probability)} · ${plural(h.observation_count, "observation")} · σ ${sigma((h.cov_m2[0] + h.cov_m2[3]) / 2)} m` }))))),
      ),
    ); // prettier-ignore
  }

  function showSightings(chosen: Chosen): void {
    const { sightings } = chosen;
    if (chosen.history[0]?.marking) {
      shownImage = "";
      return fill(seen);
    }
    const s = sightings?.[chosen.sightingIndex];
    if (!sightings || !s) {
      const text = sightings ? "No images of this object up to this time." : "Loading images …";
      shownImage = "";
      return fill(seen, el("h3", { textContent: "Images" }), el("p", { class: sightings ? "hint" : "hint loading", textContent: text }));
    }
    const i = chosen.sightingIndex;
    const key = `${chosen.map} ${s.drive_uuid} ${s.frame_index} ${s.match_index} ${whole}`;
    const stepFocus = document.activeElement instanceof HTMLElement ? document.activeElement.dataset["focus"] : undefined;
    const slider = el("input", { type: "range", min: "0", max: String(sightings.length - 1), step: "1", value: String(i), data: { focus: "slider" }, aria: { label: "Image pair" } });
    slider.addEventListener("input", () => actions.showSighting(Number(slider.value)));
    const box = el("input", { type: "checkbox", checked: whole, data: { focus: "whole" } });
    box.addEventListener("change", () => {
      whole = box.checked;
      showSightings(chosen);
    });
    const step = (to: number, text: string, label: string) =>
      el("button", { type: "button", class: "step", textContent: text, title: label, disabled: to < 0 || to >= sightings.length, data: { focus: label }, aria: { label }, onclick: () => actions.showSighting(to) });
    const holder = seen.querySelector(".images") ?? el("div", { class: "images" });
    holder.classList.toggle("whole", whole);
    fill(
      seen,
      el("h3", {}, "Images", el("label", { class: "check small" }, box, "whole image")),
      holder,
      el("div", { class: "stepper" }, step(i - 1, "‹", "Previous image pair (P)"), slider, step(i + 1, "›", "Next image pair (N)")),
      el("p", { class: "hint", textContent: `Image pair ${i + 1} of ${sightings.length}${chosen.truncated ? " (the first ones)" : ""} · ${s.drive_id} · frame pair ${s.frame_index} · ${utc(s.captured_at)} UTC` }),
      el("p", { class: "hint", textContent: `${s.range_m.toFixed(1)} m away · score ${scoreText(s.left)} left, ${scoreText(s.right)} right · residual ${s.residual_rms_px.toFixed(2)} px` }),
    ); // prettier-ignore
    if (stepFocus) seen.querySelector<HTMLElement>(`[data-focus="${stepFocus}"]:not(:disabled)`)?.focus();
    if (key !== shownImage) {
      shownImage = key;
      void showImages(holder, chosen.map, s);
    }
  }

  async function showImages(holder: Element, map: string, s: Sighting): Promise<void> {
    loadingImages?.abort();
    const controller = (loadingImages = new AbortController());
    holder.classList.add("busy");
    const figures = await Promise.all((["left", "right"] as const).map((side) => figure(map, s, side, controller.signal)));
    if (controller.signal.aborted) {
      figures.forEach(({ url }) => url && URL.revokeObjectURL(url));
      return;
    }
    fill(holder, ...figures.map(({ node }) => node));
    holder.classList.remove("busy");
    urls.forEach((url) => URL.revokeObjectURL(url));
    urls = figures.flatMap(({ url }) => (url ? [url] : []));
  }

  async function figure(map: string, s: Sighting, side: "left" | "right", signal: AbortSignal) {
    const caption = el("figcaption", { textContent: side });
    try {
      const url = URL.createObjectURL(await api.image(map, s, side, whole, signal));
      const image = el("img", { src: url, alt: `${side} image of frame pair ${s.frame_index} with the box of the detection` });
      await image.decode().catch(() => undefined);
      const start = { drive_uuid: s.drive_uuid, frame_index: s.frame_index };
      const larger = el("button", { type: "button", class: "crop", title: "Open the images (I)", aria: { label: `Open the ${side} image` }, onclick: () => actions.openImages(start) }, image);
      return { node: el("figure", {}, larger, caption), url };
    } catch (error) {
      const text = error instanceof ApiError ? error.message : "The image cannot be shown.";
      return { node: el("figure", { class: "missing" }, el("p", { textContent: text }), caption), url: null };
    }
  }

  function hide(): void {
    host.hidden = true;
    loadingImages?.abort();
    shownImage = "";
  }

  return {
    show, hide,
    loading: (id: string) => message(id, "Loading the history …", "loading"),
    failed: (id: string, error: unknown) => message(id, messageOf(error), "bad"),
  };
}

function row(name: string, ...values: (Node | string)[]): Node[] {
  return [el("dt", { textContent: name }), el("dd", {}, ...values)];
}

const lineRows = (line: Marking): Node[] => [
  ...row("Sigma across", el("span", { class: "mono", textContent: `${line.sigma_lateral_m.toFixed(3)} m` }), el("small", { textContent: "largest along the line" })),
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
