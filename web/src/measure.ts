// Distances and areas on the ground of the map, with the sigma that follows from the covariances of the cones they are measured between.
import { api, type HistoryItem, type Vec3 } from "./api";
import { el, fill, shortId } from "./dom";
import type { Cone } from "./kinds";
import type { Stage } from "./scene";

/** xx, xy, yy on the ground. */
export type Cov2 = [number, number, number];

export interface MeasuredPoint {
  xyz: Vec3;
  /** The cone that it was snapped to. */
  id: string | null;
  /** Null for a free point, or until it is known. */
  cov: Cov2 | null;
}

type Kind = "line" | "area";

/** Standard deviation of a function of the points with these gradients (N, 2): a cone that occurs twice is one variable. */
function sigmaOf(points: MeasuredPoint[], gradients: [number, number][]): number | null {
  const sums = new Map<string, { g: [number, number]; cov: Cov2 }>();
  for (const [i, { id, cov }] of points.entries()) {
    if (!cov || id === null) return null;
    const sum = sums.get(id) ?? { g: [0, 0], cov };
    sum.g[0] += gradients[i]?.[0] ?? 0;
    sum.g[1] += gradients[i]?.[1] ?? 0;
    sums.set(id, sum);
  }
  let variance = 0;
  for (const { g: [a, b], cov: [xx, xy, yy] } of sums.values()) variance += a * a * xx + 2 * a * b * xy + b * b * yy;
  return Math.sqrt(variance);
}

/** Horizontal length of a polyline in metres of the map's CRS, and its sigma; null if a point is free. */
export function lengthOf(points: MeasuredPoint[]): { value: number; sigma: number | null } {
  const gradients = points.map((): [number, number] => [0, 0]);
  let value = 0;
  for (let i = 1; i < points.length; i++) {
    const [a, b] = [points[i - 1]!.xyz, points[i]!.xyz];
    const [dx, dy] = [b[0] - a[0], b[1] - a[1]];
    const length = Math.hypot(dx, dy);
    value += length;
    if (!length) continue;
    for (const [index, sign] of [[i - 1, -1], [i, 1]] as const) {
      gradients[index]![0] += (sign * dx) / length;
      gradients[index]![1] += (sign * dy) / length;
    }
  }
  return { value, sigma: sigmaOf(points, gradients) };
}

/** Area of the polygon on the ground in square metres, and its sigma. */
export function areaOf(points: MeasuredPoint[]): { value: number; sigma: number | null } {
  const at = (i: number) => points[(i + points.length) % points.length]!.xyz;
  // From the first point, so that large coordinates cancel no digits.
  const [x0, y0] = at(0);
  const doubled = points.reduce((sum, _, i) => sum + (at(i)[0] - x0) * (at(i + 1)[1] - y0) - (at(i + 1)[0] - x0) * (at(i)[1] - y0), 0);
  const sign = Math.sign(doubled) || 1;
  const gradients = points.map((_, i): [number, number] => [(sign * (at(i + 1)[1] - at(i - 1)[1])) / 2, (sign * (at(i - 1)[0] - at(i + 1)[0])) / 2]);
  return { value: Math.abs(doubled) / 2, sigma: sigmaOf(points, gradients) };
}

/** Distance of the last point from the line through the first two: the width between two rows of cones. */
export function widthOf([a, b, c]: [MeasuredPoint, MeasuredPoint, MeasuredPoint]): { value: number; sigma: number | null } {
  const [ux, uy] = [b.xyz[0] - a.xyz[0], b.xyz[1] - a.xyz[1]];
  const [wx, wy] = [c.xyz[0] - a.xyz[0], c.xyz[1] - a.xyz[1]];
  const length = Math.hypot(ux, uy);
  const cross = ux * wy - uy * wx;
  const sign = Math.sign(cross) || 1;
  const [nx, ny] = [(-uy / length) * sign, (ux / length) * sign];
  const along = (ux * wx + uy * wy) / (length * length);
  return { value: Math.abs(cross) / length, sigma: sigmaOf([a, b, c], [[-nx * (1 - along), -ny * (1 - along)], [-nx * along, -ny * along], [nx, ny]]) };
}

/** With a third decimal only if the sigma is below 1 cm. */
export function quantity({ value, sigma }: { value: number; sigma: number | null }, unit: string): string {
  if (sigma === null) return `${value.toFixed(2)} ${unit}`;
  const digits = sigma < 0.0095 ? 3 : 2;
  return `${value.toFixed(digits)} ± ${sigma.toFixed(digits)} ${unit}`;
}

const SVG = "http://www.w3.org/2000/svg";

export interface MeasureActions {
  map(): string;
  cone(id: string): Cone | undefined;
  /** What is measured has changed; null: nothing is measured any more. */
  changed(measured: string | null): void;
}

export function createMeasure(stage: Stage, host: HTMLElement, actions: MeasureActions) {
  let kind: Kind = "line";
  let points: MeasuredPoint[] = [];
  let active = false;
  let said = "";
  let opening = 0;

  const shape = document.createElementNS(SVG, "path");
  const dots = document.createElementNS(SVG, "g");
  const svg = document.createElementNS(SVG, "svg");
  svg.setAttribute("class", "measure-shape");
  svg.setAttribute("aria-hidden", "true");
  svg.append(shape, dots);
  const labels = el("div", { class: "labels", aria: { hidden: "true" } });
  const tabs = ([["line", "Distance"], ["area", "Area"]] as const).map(([value, text]) =>
    el("button", { type: "button", textContent: text, data: { value }, onclick: () => ((kind = value), changed()) }));
  const result = el("div", { class: "measure-result", role: "status", aria: { live: "polite" } });
  const copy = el("button", { type: "button", textContent: "Copy", onclick: () => void copyResult() });
  const undo = el("button", { type: "button", textContent: "Undo", title: "Remove the last point (Backspace)", onclick: () => removeLast() });
  const box = el("section", { class: "measure", hidden: true, aria: { label: "Measure" } },
    el("div", { class: "measure-head" }, el("div", { class: "segmented", role: "group", aria: { label: "What to measure" } }, ...tabs),
      el("button", { type: "button", class: "close", textContent: "×", title: "Close (Esc)", aria: { label: "End measuring" }, onclick: () => end() })),
    result, el("div", { class: "measure-actions" }, copy, undo)); // prettier-ignore
  host.append(svg, labels, box);

  stage.beforeDraw(() => {
    if (active) place();
  });

  /** Where the points are on the canvas now. */
  function place(): void {
    const pixels = points.map(({ xyz }) => stage.project(xyz));
    const drawn = pixels.every((p) => p !== null) ? pixels.map(([x, y]) => `${x.toFixed(1)} ${y.toFixed(1)}`) : [];
    shape.setAttribute("d", drawn.length > 1 ? `M${drawn.join("L")}${kind === "area" && drawn.length > 2 ? "Z" : ""}` : "");
    shape.setAttribute("class", kind);
    [...dots.children].forEach((dot, i) => {
      const p = pixels[i];
      dot.setAttribute("visibility", p ? "visible" : "hidden");
      if (p) dot.setAttribute("transform", `translate(${p[0].toFixed(1)} ${p[1].toFixed(1)})`);
    });
    [...labels.children].forEach((node, i) => {
      const [a, b] = [pixels[i], pixels[(i + 1) % pixels.length]];
      const label = node as HTMLElement;
      label.hidden = !a || !b || Math.hypot(a[0] - b[0], a[1] - b[1]) < 40;
      if (a && b) label.style.transform = `translate(${Math.round((a[0] + b[0]) / 2)}px, ${Math.round((a[1] + b[1]) / 2)}px)`;
    });
  }

  function show(): void {
    box.hidden = !active;
    svg.style.display = active ? "" : "none";
    labels.hidden = !active;
    host.classList.toggle("measuring", active);
    for (const tab of tabs) tab.setAttribute("aria-pressed", String(tab.dataset["value"] === kind));
    dots.replaceChildren(...points.map(({ id }) => {
      const dot = document.createElementNS(SVG, "circle");
      dot.setAttribute("r", id ? "5" : "3.5");
      dot.setAttribute("class", id ? "snapped" : "free");
      return dot;
    }));
    const sides = points.slice(1).map((p, i): [MeasuredPoint, MeasuredPoint] => [points[i]!, p]);
    if (kind === "area" && points.length > 2) sides.push([points.at(-1)!, points[0]!]);
    labels.replaceChildren(...sides.map((side) => el("span", { class: "measure-label", textContent: quantity(lengthOf(side), "m") })));
    undo.disabled = !points.length;
    const rows = resultRows();
    copy.disabled = !rows.length;
    const free = points.filter((p) => p.id === null).length;
    fill(result,
      ...rows.map(([name, text], i) => el("div", { class: i ? "row" : "row total" }, el("span", { textContent: name }), el("b", { textContent: text }))),
      el("p", { class: "hint", textContent: !rows.length ? `Click ${kind === "line" ? "two" : "three"} or more cones or points on the ground.`
        : free ? "Points on the ground have no sigma; cones do." : "Horizontal, 1 sigma; errors of the cones are taken as independent." })); // prettier-ignore
    said = rows.map(([name, text]) => `${name}\t${text}`).join("\n");
    place();
    stage.draw();
  }

  function resultRows(): [string, string][] {
    if (points.length < 2 || (kind === "area" && points.length < 3)) return [];
    const names = points.map((p, i) => (p.id ? shortId(p.id) : `point ${i + 1}`));
    if (kind === "area") return [["Area", quantity(areaOf(points), "m²")], ["Perimeter", quantity(lengthOf([...points, points[0]!]), "m")]];
    const rows: [string, string][] = [[points.length > 2 ? "Total" : "Distance", quantity(lengthOf(points), "m")]];
    const [a, b, last] = [points[0]!, points[1]!, points.at(-1)!];
    if (points.length > 2 && Math.hypot(a.xyz[0] - b.xyz[0], a.xyz[1] - b.xyz[1]) > 0) rows.push(["Last point to line 1–2", quantity(widthOf([a, b, last]), "m")]);
    if (points.length > 2) for (let i = 1; i < points.length; i++) rows.push([`${names[i - 1]} – ${names[i]}`, quantity(lengthOf([points[i - 1]!, points[i]!]), "m")]);
    return rows;
  }

  function changed(): void {
    active = true;
    actions.changed(format());
    show();
  }

  const format = () => [kind, ...points.map((p) => p.id ?? p.xyz.map((v) => v.toFixed(3)).join(","))].join(":");

  /** The covariance of the cone's state that is drawn: the version at this position. */
  async function snap(cone: Cone): Promise<void> {
    const point: MeasuredPoint = { xyz: cone.xyz, id: cone.id, cov: null };
    points.push(point);
    changed();
    const { history } = await api.history(actions.map(), cone.id, null);
    const off = (h: HistoryItem) => Math.hypot(h.xyz_m[0] - cone.xyz[0], h.xyz_m[1] - cone.xyz[1]);
    const drawn = history.reduceRight<HistoryItem | null>((best, h) => (best === null || off(h) < off(best) - 1e-4 ? h : best), null);
    if (drawn) point.cov = [drawn.cov_m2[0], drawn.cov_m2[1], drawn.cov_m2[3]];
    if (active) show();
  }

  function removeLast(): void {
    points.pop();
    changed();
  }

  function end(): void {
    active = false;
    points = [];
    actions.changed(null);
    show();
  }

  async function copyResult(): Promise<void> {
    await copyText(said);
    copy.textContent = "Copied";
    window.setTimeout(() => (copy.textContent = "Copy"), 1500);
  }

  return {
    active: () => active,
    toggle: () => (active ? end() : changed()),
    end,
    /** A click on a cone, or else on the ground; false while nothing is measured. */
    click(cone: Cone | null, ground: Vec3 | null): boolean {
      if (!active) return false;
      if (cone) void snap(cone).catch(() => show());
      else if (ground) {
        points.push({ xyz: ground, id: null, cov: null });
        changed();
      }
      return true;
    },
    key(event: KeyboardEvent): boolean {
      if (event.key === "m" || event.key === "M") active ? end() : changed();
      else if (active && event.key === "Backspace" && points.length) removeLast();
      else return false;
      return true;
    },
    /** Show what an address says; cones are found once they are drawn. */
    open(measured: string | null): void {
      if (measured === (active ? format() : null)) return;
      const mine = ++opening;
      active = measured !== null;
      points = [];
      const [what, ...parts] = (measured ?? "").split(":");
      kind = what === "area" ? "area" : "line";
      void (async () => {
        for (const part of parts) {
          const cone = actions.cone(part);
          const xyz = part.split(",").map(Number);
          if (cone) await snap(cone).catch(() => undefined);
          else if (xyz.length === 3 && xyz.every(Number.isFinite)) points.push({ xyz: xyz as Vec3, id: null, cov: null });
          if (mine !== opening) return;
        }
        show();
      })();
      show();
    },
  };
}
export type Measure = ReturnType<typeof createMeasure>;

/** The clipboard of a page on loopback; without permission, by a selection. */
export async function copyText(text: string): Promise<void> {
  try {
    await navigator.clipboard.writeText(text);
  } catch {
    const area = el("textarea", { value: text, class: "offscreen" });
    document.body.append(area);
    area.select();
    document.execCommand("copy");
    area.remove();
  }
}
