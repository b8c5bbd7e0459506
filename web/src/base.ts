// Base layers: LiDAR points and lane boundaries under the cones, in muted colours.
import { Color, Group } from "three";
import { LineMaterial } from "three/addons/lines/LineMaterial.js";
import { LineSegments2 } from "three/addons/lines/LineSegments2.js";
import { LineSegmentsGeometry } from "three/addons/lines/LineSegmentsGeometry.js";
import { api, type BaseLayer, type BaseLine } from "./api";
import { createPoints } from "./points";
import type { Stage } from "./scene";
import type { State } from "./state";
import { colours } from "./theme";

export function createBase(stage: Stage, onTrouble: (error: unknown) => void) {
  const points = createPoints(stage, onTrouble);
  const lines = createLines(stage);
  let opening = 0;

  return {
    /** Read the layers of a map; they are drawn as they arrive. */
    async open(map: string): Promise<BaseLayer[]> {
      const mine = ++opening;
      const [base, found] = await Promise.all([api.base(map), api.baseLines(map)]);
      if (mine !== opening) return [];
      points.setTiles(base.tiles, (sha256) => api.baseTile(map, sha256));
      lines.show(found.lines);
      stage.warm();
      document.documentElement.dataset["lines"] = String(found.lines.length);
      if (base.truncated || found.truncated) onTrouble(new Error("The base layers are too large for this page: some of them are not shown."));
      return base.layers;
    },
    close(): void {
      opening += 1;
      points.setTiles([], () => Promise.reject(new Error("no map")));
      lines.show([]);
    },
    apply(state: State): void {
      points.setStyle(colours(), state.scene);
      lines.setColour(colours().line);
      points.setVisible(state.points);
      lines.setVisible(state.lines);
    },
  };
}

/** Above the road, so that points on it do not hide them. */
const LIFT_M = 0.05;
const STYLES = {
  painted: { width_px: 1.5, dashed: false, faint: 0 },
  dashed: { width_px: 1.5, dashed: true, faint: 0 },
  edge: { width_px: 1.2, dashed: false, faint: 0.2 },
  virtual: { width_px: 1, dashed: false, faint: 0.6 },
} as const;
type Style = keyof typeof STYLES;

function styleOf({ kind, subtype }: BaseLine): Style {
  const words = `${kind} ${subtype ?? ""}`.toLowerCase();
  if (/virtual|reference|lane_border|centerline/.test(words)) return "virtual";
  if (/dashed|broken/.test(words)) return "dashed";
  if (/curb|kerb|border|wall|fence|guard|rail|edge|grass/.test(words)) return "edge";
  return "painted";
}

/** Lane boundaries: painted and dashed lines, kerbs and edges, virtual lines. */
function createLines(stage: Stage) {
  const group = new Group();
  stage.scene.add(group);
  let colour = new Color();
  const meshes = new Map<Style, LineSegments2>();

  function tint(): void {
    for (const [style, mesh] of meshes) {
      (mesh.material as LineMaterial).color.copy(colour).lerp(new Color(colours().background), STYLES[style].faint);
    }
    stage.draw();
  }

  return {
    show(lines: BaseLine[]): void {
      for (const mesh of meshes.values()) {
        mesh.geometry.dispose();
        (mesh.material as LineMaterial).dispose();
      }
      meshes.clear();
      group.clear();
      const pieces: Record<Style, number[]> = { painted: [], dashed: [], edge: [], virtual: [] };
      for (const line of lines) {
        const into = pieces[styleOf(line)];
        const v = line.xyz_m;
        for (let i = 0; i + 5 < v.length; i += 3) {
          into.push(v[i] ?? 0, v[i + 1] ?? 0, (v[i + 2] ?? 0) + LIFT_M, v[i + 3] ?? 0, v[i + 4] ?? 0, (v[i + 5] ?? 0) + LIFT_M);
        }
      }
      for (const style of Object.keys(pieces) as Style[]) {
        if (!pieces[style].length) continue;
        const { width_px, dashed } = STYLES[style];
        const geometry = new LineSegmentsGeometry().setPositions(pieces[style]);
        const mesh = new LineSegments2(geometry, new LineMaterial({ linewidth: width_px, dashed, dashSize: 3, gapSize: 3 }));
        if (dashed) mesh.computeLineDistances();
        mesh.frustumCulled = false;
        meshes.set(style, mesh);
        group.add(mesh);
      }
      tint();
    },
    setVisible(on: boolean): void {
      group.visible = on;
      stage.draw();
    },
    setColour(css: string): void {
      colour = new Color(css);
      tint();
    },
  };
}
