// Lane boundaries: painted lines, dashed ones, kerbs and edges, and lines that only exist on paper.
import { Color, Group } from "three";
import { LineMaterial } from "three/addons/lines/LineMaterial.js";
import { LineSegments2 } from "three/addons/lines/LineSegments2.js";
import { LineSegmentsGeometry } from "three/addons/lines/LineSegmentsGeometry.js";
import type { BaseLine } from "./api";
import type { Stage } from "./scene";

/** Above the road, so that points on it do not hide them. */
const LIFT_M = 0.05;
const STYLES = {
  painted: { width_px: 2.6, dashed: false, faint: 0 },
  dashed: { width_px: 2.6, dashed: true, faint: 0 },
  edge: { width_px: 1.6, dashed: false, faint: 0.15 },
  thought: { width_px: 1, dashed: false, faint: 0.55 },
} as const;
type Style = keyof typeof STYLES;

function styleOf({ kind, subtype }: BaseLine): Style {
  const words = `${kind} ${subtype ?? ""}`.toLowerCase();
  if (/virtual|reference|lane_border|centerline/.test(words)) return "thought";
  if (/dashed|broken/.test(words)) return "dashed";
  if (/curb|kerb|border|wall|fence|guard|rail|edge|grass/.test(words)) return "edge";
  return "painted";
}

export function createLines(stage: Stage, background: string) {
  const group = new Group();
  stage.scene.add(group);
  let colour = new Color();
  const meshes = new Map<Style, LineSegments2>();

  function tint(): void {
    for (const [style, mesh] of meshes) {
      (mesh.material as LineMaterial).color.copy(colour).lerp(new Color(background), STYLES[style].faint);
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
      const pieces: Record<Style, number[]> = { painted: [], dashed: [], edge: [], thought: [] };
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
