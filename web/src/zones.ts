// Work zones of the road now: the closed area on the ground, and what is closed, at its middle.
import { DoubleSide, Group, LineBasicMaterial, LineLoop, Mesh, MeshBasicMaterial, Shape, ShapeGeometry, BufferGeometry, Vector2, Vector3 } from "three";
import { api, type Vec3, type WorkZone } from "./api";
import { el, plural } from "./dom";
import type { Stage } from "./scene";

/** Above the road, below lane boundaries. */
const LIFT_M = 0.03;
const APART_PX = 90;
const COLOUR = "#f2a900";

interface Label {
  corners: Vec3[];
  node: HTMLElement;
}

export function createZones(stage: Stage, host: HTMLElement) {
  const layer = el("div", { class: "zones" });
  host.append(layer);
  const group = new Group();
  stage.scene.add(group);
  const area = new MeshBasicMaterial({ color: COLOUR, transparent: true, opacity: 0.28, side: DoubleSide, depthWrite: false });
  const edge = new LineBasicMaterial({ color: COLOUR });
  let labels: Label[] = [];
  let opening = 0;

  function draw(zones: WorkZone[]): void {
    for (const child of group.children) if (child instanceof Mesh || child instanceof LineLoop) child.geometry.dispose();
    group.clear();
    layer.replaceChildren();
    labels = zones.map((zone) => {
      const corners: Vector3[] = [];
      for (let i = 0; i < zone.ring_m.length; i += 3) corners.push(new Vector3(zone.ring_m[i], zone.ring_m[i + 1], zone.ring_m[i + 2]));
      const height = (corners[0]?.z ?? 0) + LIFT_M;
      const shape = new ShapeGeometry(new Shape(corners.map(({ x, y }) => new Vector2(x, y)))).translate(0, 0, height);
      const fill = new Mesh(shape, area);
      fill.renderOrder = 1; // markers are above
      group.add(fill, new LineLoop(new BufferGeometry().setFromPoints(corners.map(({ x, y }) => new Vector3(x, y, height))), edge));
      const node = layer.appendChild(el("span", { class: "zone", hidden: true, textContent: wordsOf(zone) }));
      return { corners: corners.map((corner) => corner.toArray()), node };
    });
    document.documentElement.dataset["zones"] = String(zones.length);
    stage.draw();
  }

  stage.beforeDraw(() => {
    const shown: [number, number][] = [];
    const { clientWidth: width, clientHeight: height } = stage.canvas;
    for (const { corners, node } of labels) {
      // Below the lowest corner in view.
      const seen = corners.map((at) => stage.project(at)).filter((pixel) => pixel && pixel[0] > 0 && pixel[0] < width && pixel[1] > 0 && pixel[1] < height - 30);
      const pixel = seen.reduce((low, one) => (one && (!low || one[1] > low[1]) ? one : low), null);
      node.hidden = !pixel || shown.some(([x, y]) => Math.abs(x - pixel[0]) < 2 * APART_PX && Math.abs(y - pixel[1]) < 24);
      if (node.hidden || !pixel) continue;
      shown.push(pixel);
      node.style.transform = `translate(${Math.round(pixel[0])}px, ${Math.round(pixel[1])}px) translate(-50%, 8px)`;
    }
  });

  return {
    /** Draws the zones of a map at a time (null: now); an answer that comes after another request is dropped. */
    async open(map: string, valid: string | null): Promise<void> {
      const mine = ++opening;
      const { zones } = await api.zones(map, valid);
      if (mine === opening) draw(zones);
    },
    close(): void {
      opening += 1;
      draw([]);
    },
  };
}

function wordsOf(zone: WorkZone): string {
  const lanes = zone.closed_lane_count === null ? "closed" : `${plural(zone.closed_lane_count, "lane")} closed`;
  return `Work zone · ${zone.closed_side === null ? "" : `${lanes} on the ${zone.closed_side} · `}${Math.round(zone.length_m)} m`;
}
