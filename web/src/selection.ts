// The selected feature: its details in the panel, its ellipse and camera in the scene, its images.
import { api, type Decisions, type FrameView, type HistoryItem, type Sighting, type Timeline } from "./api";
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
  let shownImages = "";
  /** The camera of the image that is shown. */
  let imaged: FrameView | null = null;

  const panel = createPanel(host, {
    close: () => void select(null),
    showChangeset: page.showChangeset,
    setFactor: (factor) => {
      if (chosen) chosen = { ...chosen, factor };
      draw();
    },
    centre,
    decided: page.decided,
  });

  const shown = () => shownState(page.state(), page.timeline()?.changesets ?? []);

  async function select(id: string | null, centred = false): Promise<void> {
    const mine = ++selecting;
    const state = page.state();
    if (id !== state.feature) state.image = null;
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
      chosen = { id, map, srid: page.timeline()?.srid ?? 0, history, known, sightings: chosen?.sightings ?? null, reached, kind: null, factor: chosen?.factor ?? null, decisions: null };
      draw();
      if (centred) centre();
      const { sightings } = await api.sightings(map, id);
      if (mine !== selecting || !chosen) return;
      chosen = { ...chosen, sightings };
      draw();
    } catch (error) {
      if (mine === selecting) panel.failed(id, error);
    }
  }

  function clear(): void {
    chosen = null;
    shownImages = "";
    panel.hide();
    if (viewer.dock === panel.images) viewer.clear();
  }

  /** Read it again: what is known about it may have changed. */
  async function again(): Promise<void> {
    if (chosen) await select(chosen.id);
  }

  function draw(): void {
    if (!chosen) {
      overlays.showSelection(null, null, 1);
      return;
    }
    chosen = { ...chosen, reached: shown().reached, decisions: page.decisions() };
    const drawn: Chosen = { ...chosen, kind: kindShown(chosen) };
    const now = stateOf(drawn);
    const ellipse = now && !now.marking ? ellipse95(now.cov_m2) : null;
    overlays.showSelection(now?.xyz_m ?? null, ellipse, ellipse ? chosen.factor ?? niceFactor(ellipse) : 1, now?.marking?.line_m);
    panel.show(drawn);
    showImages(chosen);
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

  /** The best images of the state that is shown, or those of the address; beside the drive before, if anything changed. */
  function showImages(shown: Chosen): void {
    const { map, id, history, sightings } = shown;
    const now = stateOf(shown) ?? history[0];
    panel.images.hidden = !now || Boolean(now.marking); // no image shows a marking alone
    if (viewer.dock !== panel.images) shownImages = "";
    else if (now && sightings && !panel.images.hidden) {
      const key = `${map} ${id} ${now.version} ${now.changeset_no}`;
      if (key === shownImages) return;
      shownImages = key;
      void viewer.show(subjectOf(map, id, history, now, sightings), page.state().image, now.kind !== "confirmed");
    }
  }

  function follow(view: FrameView | null): void {
    const { follow: on, plan } = page.state().scene;
    stage.lookFrom(on && !plan ? view : null);
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
    /** Where its images are, unless the review shows others. */
    images: panel.images,
    walked(start: Start): void {
      if (!chosen || viewer.dock !== panel.images) return;
      page.state().image = start;
      page.writeChoice();
    },
    camera(view: FrameView | null): void {
      if (view !== imaged) follow(view);
      imaged = view;
      const now = chosen && (stateOf(chosen) ?? chosen.history[0]);
      overlays.showCamera(view, now?.xyz_m ?? null);
    },
    /** The choice to follow images changed. */
    followImage: () => follow(imaged),
    /** Read it again if another state of the database is shown. */
    follow: () => {
      if (chosen && chosen.known !== shown().known) void select(chosen.id);
    },
  };
}
