// Areas on the ground with a label each: work zones of the road now, and where they differ from their plans.
import { DoubleSide, Group, LineBasicMaterial, LineLoop, Mesh, MeshBasicMaterial, Shape, ShapeGeometry, BufferGeometry, Vector2, Vector3 } from "three";
import { api, type DifferenceRow, type Vec3, type WorkZone } from "./api";
import { el, plural } from "./dom";
import { differenceWords } from "./queues";
import type { Stage } from "./scene";

/** Above the road, below lane boundaries. */
const LIFT_M = 0.03;
const APART_PX = 90;
const ZONE = "#f2a900";
const [DIFFERS, PLANNED] = ["#c9184a", "#2b7de1"];

interface Area {
  corners: Vec3[];
  colour: string;
  /** Its label; empty: none. */
  words: string;
}
interface Label {
  corners: Vec3[];
  node: HTMLElement;
}

/** `edge`: where labels stand, below the lowest or above the highest corner in view; `name`: of the layer, for tests. */
function createAreas(stage: Stage, host: HTMLElement, name: string, edge: "below" | "above") {
  const layer = el("div", { class: `zones ${edge}` });
  host.append(layer);
  const group = new Group();
  stage.scene.add(group);
  const paints = new Map<string, { area: MeshBasicMaterial; edge: LineBasicMaterial }>();
  let labels: Label[] = [];

  function paint(colour: string) {
    const known = paints.get(colour) ?? { area: new MeshBasicMaterial({ color: colour, transparent: true, opacity: 0.28, side: DoubleSide, depthWrite: false }), edge: new LineBasicMaterial({ color: colour }) };
    paints.set(colour, known);
    return known;
  }

  stage.beforeDraw(() => {
    const shown: [number, number][] = [];
    const { clientWidth: width, clientHeight: height } = stage.canvas;
    for (const { corners, node } of labels) {
      const seen = corners.map((at) => stage.project(at)).filter((pixel) => pixel && pixel[0] > 0 && pixel[0] < width && pixel[1] > 30 && pixel[1] < height - 30);
      const pixel = seen.reduce((best, one) => (one && (!best || (edge === "below" ? one[1] > best[1] : one[1] < best[1])) ? one : best), null);
      node.hidden = !pixel || shown.some(([x, y]) => Math.abs(x - pixel[0]) < 2 * APART_PX && Math.abs(y - pixel[1]) < 24);
      if (node.hidden || !pixel) continue;
      shown.push(pixel);
      const beside = edge === "below" ? "+ 8px" : "- 8px - 100%";
      node.style.transform = `translate(clamp(4px, ${Math.round(pixel[0])}px - 50%, ${width - 4}px - 100%), calc(${Math.round(pixel[1])}px ${beside}))`;
    }
  });

  return function draw(areas: Area[]): void {
    for (const child of group.children) if (child instanceof Mesh || child instanceof LineLoop) child.geometry.dispose();
    group.clear();
    layer.replaceChildren();
    labels = [];
    for (const { corners, colour, words } of areas) {
      const height = (corners[0]?.[2] ?? 0) + LIFT_M;
      const shape = new ShapeGeometry(new Shape(corners.map(([x, y]) => new Vector2(x, y)))).translate(0, 0, height);
      const fill = new Mesh(shape, paint(colour).area);
      fill.renderOrder = 1; // markers are above
      group.add(fill, new LineLoop(new BufferGeometry().setFromPoints(corners.map(([x, y]) => new Vector3(x, y, height))), paint(colour).edge));
      if (words) labels.push({ corners, node: layer.appendChild(el("span", { class: "zone", hidden: true, textContent: words })) });
    }
    document.documentElement.dataset[name] = String(labels.length);
    stage.draw();
  };
}

export function createZones(stage: Stage, host: HTMLElement) {
  const draw = createAreas(stage, host, "zones", "below");
  let opening = 0;
  return {
    /** Draws the zones of a map at a time (null: now); an answer that comes after another request is dropped. */
    async open(map: string, valid: string | null): Promise<void> {
      const mine = ++opening;
      const { zones } = await api.zones(map, valid);
      if (mine === opening) draw(zones.map((zone) => ({ corners: threes(zone.ring_m), colour: ZONE, words: wordsOf(zone) })));
    },
    close(): void {
      opening += 1;
      draw([]);
    },
  };
}

/** Differences from plans: the zone, and the place of its plan. `groundAt`: height beside a position. */
export function createDifferences(stage: Stage, host: HTMLElement, groundAt: (x: number, y: number) => number) {
  const draw = createAreas(stage, host, "differences", "above");
  return {
    /** Those that last at a time (null: now). */
    show(rows: DifferenceRow[], valid: string | null): void {
      const at = valid === null ? Date.now() : Date.parse(valid);
      const lasting = rows.filter((r) => r.rank !== null && r.verdict !== "wrong" && (r.from_at === null || Date.parse(r.from_at) <= at) && (r.until_at === null || Date.parse(r.until_at) >= at));
      draw(lasting.flatMap((r) => {
        const plans = r.plan_rings_m.map((ring) => ({ corners: twos(ring, r.at_m[2] ?? groundAt(r.at_m[0], r.at_m[1])), colour: PLANNED, words: "" }));
        const zone = r.zone_ring_m.length ? [{ corners: threes(r.zone_ring_m), colour: DIFFERS, words: "" }] : [];
        const [first, ...rest] = [...zone, ...plans];
        return first ? [{ ...first, words: differenceWords(r) }, ...rest] : [];
      })); // prettier-ignore
    },
  };
}

const threes = (flat: number[]): Vec3[] => Array.from({ length: flat.length / 3 }, (_, i) => flat.slice(3 * i, 3 * i + 3) as Vec3);
const twos = (flat: number[], z: number): Vec3[] => Array.from({ length: flat.length / 2 }, (_, i): Vec3 => [flat[2 * i] ?? 0, flat[2 * i + 1] ?? 0, z]);

function wordsOf(zone: WorkZone): string {
  const lanes = zone.closed_lane_count === null ? "closed" : zone.closed_lane_count === 0 ? "no lane closed" : `${plural(zone.closed_lane_count, "lane")} closed`;
  return `Work zone · ${zone.closed_side === null ? "" : `${lanes} on the ${zone.closed_side} · `}${Math.round(zone.length_m)} m`;
}
