// The tools around the scene, joined to the page's state: plan, layers, base map, coordinates, measuring, mini map, swipe.
import type { BaseMapItem, Timeline, Vec3 } from "./api";
import { createBasemap } from "./basemap";
import { createCones } from "./cones";
import { createCursor } from "./cursor";
import { messageOf, utc } from "./dom";
import { acceptedBy } from "./filters";
import type { Cone, Kind } from "./kinds";
import { createLayers } from "./layers";
import { createMeasure } from "./measure";
import { createMinimap } from "./minimap";
import { createProjection } from "./lonlat";
import { changesetOf, comparedInstants } from "./query";
import type { Stage } from "./scene";
import type { SceneState } from "./scene_state";
import type { CameraPose, State } from "./state";
import { createSwipe } from "./swipe";
import { onTheme } from "./theme";
import { createTiles, type Tiles } from "./tiles";
import "./tools.css";

export interface ToolActions {
  state(): State;
  change(values: Partial<SceneState>): void;
  cones(): Cone[];
  paper(on: boolean): void;
  trouble(text: string): void;
  /** Draw everything again, in other colours. */
  redraw(): void;
}

export function createTools(stage: Stage, host: HTMLElement, ofChanges: ReturnType<typeof createCones>, actions: ToolActions) {
  const scene = () => actions.state().scene;
  const { change } = actions;
  const projector = createProjection(() => {
    cursor.refresh();
    stage.draw();
  });
  const cursor = createCursor(stage, host, projector);
  const basemap = createBasemap(stage, host, projector, actions.trouble);
  const minimap = createMinimap(stage, host);
  const measure = createMeasure(stage, host, {
    map: () => actions.state().map,
    cone: (id) => actions.cones().find((c) => c.id === id),
    changed: (measured) => change({ measure: measured }),
  });
  const swipe = createSwipe(stage, host, ofChanges, () => createCones(stage), (at) => change({ swipe: at }));
  const layers = createLayers(host, { change, measure: () => measure.toggle(), paper: actions.paper });
  let timeline: Timeline | null = null;
  let states: [Cone[], Cone[]] | null = null;
  const tiles: [Tiles, Tiles] = [createTiles(stage), createTiles(stage)];
  let key = "";
  let ground = stage.ground;

  onTheme(() => {
    actions.redraw();
    swipe.redraw();
  });

  /** Both states, when their map, instants or cones are other ones than before. */
  async function readStates(state: State): Promise<void> {
    if (!timeline) return;
    const instants = comparedInstants(state, timeline.changesets);
    const next = JSON.stringify([state.map, instants, timeline.changesets.at(-1)?.changeset_no]);
    if (next === key) return;
    key = next;
    states = null;
    try {
      await Promise.all(tiles.map((side, i) => side.open(state.map, instants[i as 0 | 1])));
      if (key === next) await readView();
    } catch (error) {
      key = "";
      actions.trouble(`The two states cannot be compared: ${messageOf(error)}`);
    }
  }

  /** What stood then in view; marked are those that moved, and on the right the new ones. */
  async function readView(): Promise<void> {
    const of = key;
    const changed = await Promise.all(tiles.map((side) => side.load()));
    if (of !== key || (states && !changed.some(Boolean))) return;
    const kinds = new Map(actions.cones().map((c) => [c.id, c.kind]));
    const marked = ({ shown }: Tiles, those: Kind[]) => shown().cones.map((c): Cone => ({ ...c, kind: those.find((k) => k === kinds.get(c.id)) ?? c.kind }));
    states = [marked(tiles[0], ["moved"]), marked(tiles[1], ["moved", "added", "split", "height_changed"])];
    apply(actions.state());
  }

  function apply(state: State): void {
    const { scene: s } = state;
    stage.setPlan(s.plan);
    stage.showGrid(s.grid !== "none");
    cursor.labels(s.grid === "labels");
    cursor.pin(s.at);
    basemap.apply(s.basemap);
    if (ground !== stage.ground) {
      ground = stage.ground;
      basemap.clear();
    }
    layers.show(s);
    const compares = state.mode === "compare" && s.swipe !== null;
    if (compares) void readStates(state);
    else [states, key] = [null, ""];
    swipe.show(compares ? s.swipe : null, compares ? filtered(state) : null, compares ? sideNames(state) : ["", ""]);
  }

  function sideNames(state: State): [string, string] {
    const after = (no: number | null) => {
      const item = changesetOf(timeline?.changesets ?? [], no);
      return item ? `after ${utc(item.captured_from, false)}` : "";
    };
    return [state.from === 0 ? "before the first drive" : after(state.from), after(state.to)];
  }

  /** The same array while nothing changed, so that the meshes stay. */
  let shown: { of: unknown; by: string; cones: [Cone[], Cone[]] } | null = null;
  function filtered(state: State): [Cone[], Cone[]] | null {
    if (!states) return null;
    const by = JSON.stringify([[...state.hidden], state.minProbability, state.filter]);
    if (shown?.of !== states || shown.by !== by) {
      const visible = acceptedBy(state);
      shown = { of: states, by, cones: [states[0].filter(visible), states[1].filter(visible)] };
    }
    return shown.cones;
  }

  /** The point object there: lines are not measured from their middle. */
  function pointAt(x: number, y: number): Cone | null {
    const picked = swipe.pick(x, y);
    return picked?.marking ? null : picked;
  }

  return {
    /** Another map, or a new state of its timeline. */
    open(next: Timeline | null): void {
      timeline = next;
      if (next) {
        projector.open(next.map_name);
        cursor.open(next.origin_m as Vec3, next.srid);
      }
      key = "";
    },
    basemap(item: BaseMapItem | null): void {
      basemap.open(item);
      layers.offer({ basemap: item !== null });
    },
    points: (there: boolean) => layers.offer({ points: there }),
    /** A pose from an address, taken as it is. */
    setPose(pose: CameraPose): void {
      stage.setPlan(scene().plan, true);
      stage.setPose(pose);
    },
    apply,
    /** Kind and position of what the mini map shows. */
    show(places: Pick<Cone, "kind" | "xyz">[]): void {
      minimap.show(places);
    },
    /** The camera rests. */
    moved: () => void (states && readView().catch((error: unknown) => actions.trouble(messageOf(error)))),
    /** What an address says is measured, once its cones are there. */
    openMeasure: () => measure.open(scene().measure),
    pick: (x: number, y: number) => swipe.pick(x, y),
    /** True if the click was a point of a measurement. */
    click: (x: number, y: number): boolean => measure.active() && measure.click(pointAt(x, y), stage.groundAt(x, y)),
    /** A click beside all cones: its coordinates stay, until the next one. */
    clickGround(x: number, y: number): void {
      const place = scene().at === null ? stage.groundAt(x, y) : null;
      change({ at: place && [Math.round(place[0] * 1000) / 1000, Math.round(place[1] * 1000) / 1000] });
    },
    /** True if something was ended by Esc. */
    escape(): boolean {
      if (measure.active()) measure.end();
      else if (scene().at !== null) change({ at: null });
      else return false;
      return true;
    },
    key(event: KeyboardEvent): boolean {
      if (measure.key(event)) return true;
      if (event.key === "t" || event.key === "T") change({ plan: !scene().plan });
      else if (event.key === "x" || event.key === "X") cursor.copy();
      else return false;
      return true;
    },
  };
}
export type Tools = ReturnType<typeof createTools>;
