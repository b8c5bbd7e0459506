// The selected feature: its details in the panel, its ellipse and camera in the scene, its images.
import { api, type Decisions, type HistoryItem, type Sighting, type Timeline } from "./api";
import { aboutFeature } from "./decisions";
import { shortId } from "./dom";
import { isGone, type Cone, type Kind } from "./kinds";
import { ellipse95, niceFactor, type Overlays } from "./overlays";
import { createPanel, stateOf, type Chosen } from "./panel";
import { shownState } from "./query";
import type { Stage } from "./scene";
import type { State } from "./state";
import type { Start, Subject, Viewer } from "./viewer";

/** A cone as a drive left it, and where to begin: its best images. */
export async function subjectAfter(map: string, id: string, changesetNo: number): Promise<[Subject, Start | null]> {
  const [{ history }, { sightings }] = await Promise.all([api.history(map, id, null), api.sightings(map, id)]);
  const now = history.filter((h) => h.changeset_no === changesetNo).at(-1) ?? history.at(-1);
  if (!now) throw new Error(`The history of ${shortId(id)} is empty.`);
  return [subjectOf(map, id, history, now, sightings), null];
}

function subjectOf(map: string, id: string, history: HistoryItem[], now: HistoryItem, sightings: Sighting[]): Subject {
  const before = now.kind === "moved" ? history[history.indexOf(now) - 1] ?? null : null;
  return { map, id, title: shortId(id), why: now.why, now, isLast: now === history.at(-1), before, sightings };
}

export interface SelectionContext {
  state(): State;
  timeline(): Timeline | null;
  decisions(): Decisions | null;
  /** All of the state that is shown. */
  cones(): Cone[];
  writeAddress(): void;
  writeChoice(): void;
  /** Another feature is selected, or none: lists and labels follow. */
  chosen(id: string | null): void;
  decided(): void;
  showChangeset(no: number): void;
}

export function createSelection(host: HTMLElement, stage: Stage, overlays: Overlays, viewer: Viewer, page: SelectionContext) {
  let chosen: Chosen | null = null;
  /** Number of the latest selection: answers to earlier ones are dropped. */
  let selecting = 0;

  const panel = createPanel(host, {
    close: () => void select(null),
    showSighting,
    showChangeset: page.showChangeset,
    setFactor: (factor) => {
      if (chosen) chosen = { ...chosen, factor };
      draw();
    },
    centre,
    decided: page.decided,
    openImages,
  });

  const shown = () => shownState(page.state(), page.timeline()?.changesets ?? []);

  async function select(id: string | null, centred = false): Promise<void> {
    const mine = ++selecting;
    const state = page.state();
    if (id !== state.feature) state.sighting = null;
    state.feature = id;
    page.writeAddress();
    page.chosen(id);
    if (id === null) {
      clear();
      draw();
      return;
    }
    const map = state.map;
    if (chosen?.id !== id) {
      chosen = null;
      panel.loading(id);
      draw();
    }
    try {
      const { reached, known } = shown();
      const { history } = await api.history(map, id, known);
      if (mine !== selecting) return;
      // The images of before stay until there are others.
      chosen = { id, map, srid: page.timeline()?.srid ?? 0, history, known, sightings: chosen?.sightings ?? null, truncated: chosen?.truncated ?? false, sightingIndex: 0, reached, kind: null, factor: chosen?.factor ?? null, decisions: null };
      draw();
      if (centred) centre();
      const { sightings, truncated } = await api.sightings(map, id);
      if (mine !== selecting || !chosen) return;
      chosen = { ...chosen, sightings, truncated };
      draw();
    } catch (error) {
      if (mine === selecting) panel.failed(id, error);
    }
  }

  function clear(): void {
    chosen = null;
    panel.hide();
  }

  /** Read it again: what is known about it may have changed. */
  async function again(): Promise<void> {
    if (chosen) await select(chosen.id);
  }

  function showSighting(index: number): void {
    if (!chosen?.sightings) return;
    const sightingIndex = Math.max(0, Math.min(index, sightingsShown(chosen).length - 1));
    page.state().sighting = sightingIndex;
    page.writeChoice();
    draw();
  }

  function draw(): void {
    if (!chosen) {
      overlays.showSelection(null, null, 1);
      overlays.showFrustum(null);
      return;
    }
    chosen = { ...chosen, reached: shown().reached, decisions: page.decisions() };
    const drawn: Chosen = { ...chosen, kind: kindShown(chosen), sightings: chosen.sightings && sightingsShown(chosen) };
    drawn.sightingIndex = chosen.sightingIndex = sightingToShow(drawn);
    const now = stateOf(drawn);
    const ellipse = now && !now.marking ? ellipse95(now.cov_m2) : null;
    overlays.showSelection(now?.xyz_m ?? null, ellipse, ellipse ? chosen.factor ?? niceFactor(ellipse) : 1, now?.marking?.line_m);
    overlays.showFrustum(drawn.sightings?.[drawn.sightingIndex] ?? null);
    panel.show(drawn);
  }

  /** As the scene draws it, or would. */
  function kindShown(c: Chosen): Kind | null {
    const drawn = page.cones().find((cone) => cone.id === c.id)?.kind;
    const now = stateOf(c);
    if (drawn || !now) return drawn ?? null;
    const about = aboutFeature(c.decisions?.decisions ?? [], c.id, c.history.at(-1)?.xyz_m, Boolean(c.history[0]?.marking));
    if (about.some((d) => d.kind === "suppress")) return "suppressed";
    return page.state().mode !== "drive" && !isGone(now.kind) ? "standing" : now.kind;
  }

  /** Of the drives until the chosen instant; drive by drive of all drives. */
  function sightingsShown({ sightings, history, reached }: Chosen): Sighting[] {
    if (!sightings || page.state().mode === "drive") return sightings ?? [];
    const until = new Set(history.filter(reached).map((h) => h.changeset_no));
    return sightings.filter((s) => until.has(s.changeset_no));
  }

  /** The selected one, else the nearest one of the drive that is shown. */
  function sightingToShow({ sightings, history, reached }: Chosen): number {
    if (!sightings?.length) return 0;
    const { sighting } = page.state();
    if (sighting !== null) return Math.min(sighting, sightings.length - 1);
    const no = history.filter((h) => reached(h) && h.sighting_count > 0).at(-1)?.changeset_no;
    let best = -1;
    sightings.forEach((s, i) => {
      if ((s.changeset_no === no || no === undefined) && (best < 0 || s.range_m < (sightings[best]?.range_m ?? 0))) best = i;
    });
    return Math.max(best, 0);
  }

  function openImages(start: Start | null): void {
    if (!chosen) return;
    const now = stateOf(chosen) ?? chosen.history[0];
    if (!now || now.marking) return;
    const absent = now.kind === "removed" || now.kind === "missed";
    const sighting = absent ? undefined : sightingsShown(chosen)[chosen.sightingIndex];
    void viewer.open(subjectOf(chosen.map, chosen.id, chosen.history, now, chosen.sightings ?? []), start ?? sighting ?? null);
  }

  function centre(): void {
    const now = chosen && (stateOf(chosen) ?? chosen.history[0]);
    if (now) stage.lookAt(now.xyz_m, 9);
  }

  return {
    select,
    clear,
    again,
    draw,
    openImages,
    showNext: (by: number) => {
      if (chosen) showSighting(chosen.sightingIndex + by);
    },
    /** Read it again if another state of the database is shown. */
    follow: () => {
      if (chosen && chosen.known !== shown().known) void select(chosen.id);
    },
  };
}
