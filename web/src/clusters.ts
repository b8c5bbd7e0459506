// Where there are too many features to draw each: their number, at their mean position. A click there comes nearer.
import type { Vec3 } from "./api";
import { el } from "./dom";
import type { Stage } from "./scene";

/** Clusters that would be drawn nearer to each other are one. */
const APART_PX = 42;
const short = new Intl.NumberFormat("en", { notation: "compact", maximumFractionDigits: 1 });

interface Disc {
  count: number;
  at: Vec3;
  pixel: [number, number];
}

/** `mark`: before each number. */
export function createClusters(stage: Stage, host: HTMLElement, name = "", mark = "") {
  const layer = el("div", { class: `clusters ${name}`, aria: { hidden: "true" } });
  host.append(layer);
  let clusters: { at: Vec3; count: number }[] = [];
  let discs: Disc[] = [];
  const nodes: HTMLElement[] = [];

  function place(): void {
    discs = [];
    const { clientWidth: width, clientHeight: height } = stage.canvas;
    for (const { at, count } of clusters) {
      const pixel = stage.project(at);
      if (!pixel || Math.min(pixel[0], pixel[1]) < -APART_PX || pixel[0] > width + APART_PX || pixel[1] > height + APART_PX) continue;
      const near = discs.find((d) => Math.hypot(d.pixel[0] - pixel[0], d.pixel[1] - pixel[1]) < APART_PX);
      if (near) near.count += count;
      else discs.push({ at, count, pixel });
    }
    while (nodes.length < discs.length) nodes.push(layer.appendChild(el("span", { class: "cluster" })));
    for (const [i, node] of nodes.entries()) {
      const disc = discs[i];
      node.hidden = !disc;
      if (!disc) continue;
      node.textContent = mark + short.format(disc.count);
      node.style.setProperty("--size", `${Math.round(18 + 5 * Math.log10(disc.count))}px`);
      node.style.transform = `translate(${Math.round(disc.pixel[0])}px, ${Math.round(disc.pixel[1])}px)`;
    }
  }
  stage.beforeDraw(() => void ((clusters.length || discs.length) && place()));

  return {
    show(next: { xyz_m: Vec3; count: number }[]): void {
      clusters = next.filter(({ count }) => count > 0).map(({ xyz_m, count }) => ({ at: xyz_m, count }));
      stage.draw();
    },
    /** Where the cluster under a pixel is. */
    pick: (x: number, y: number): Vec3 | null => discs.find(({ pixel }) => Math.hypot(pixel[0] - x, pixel[1] - y) < APART_PX / 2)?.at ?? null,
  };
}
