// Coordinates on the ground under the cursor, in the map's CRS and as longitude and latitude; coordinates along the plan's edges.
import type { Vec3 } from "./api";
import { el } from "./dom";
import { copyText } from "./measure";
import { toDegrees, townAt, type Projector } from "./lonlat";
import type { Stage } from "./scene";

const EDGE_PX = 70;

export function createCursor(stage: Stage, host: HTMLElement, projector: Projector) {
  const grid = el("span", { class: "mono" });
  const degrees = el("span", { class: "mono" });
  const box = el("button", { type: "button", class: "cursor", hidden: true, disabled: true, title: "Copy these coordinates (X)" }, grid, degrees);
  const pin = el("i", { class: "pin", hidden: true, aria: { hidden: "true" } });
  /** Always: where in the world the picture is. */
  const where = el("div", { class: "where", title: "Middle of the picture: nearest town (GeoNames, CC BY 4.0), latitude, longitude" });
  const labels = el("div", { class: "grid-labels", hidden: true, aria: { hidden: "true" } });
  host.append(labels, pin, box);
  host.querySelector(".scalebar")?.append(where);
  let origin: Vec3 = [0, 0, 0];
  let srid = 0;
  /** Under the cursor, and where the person clicked, which stays. */
  let hovered: Vec3 | null = null;
  let pinned: Vec3 | null = null;
  let labelled = false;

  function show(): void {
    const at = pinned ?? hovered;
    box.hidden = at === null;
    box.disabled = pinned === null;
    if (!at) return;
    grid.textContent = `${(at[0] + origin[0]).toFixed(2)} E  ${(at[1] + origin[1]).toFixed(2)} N`;
    const projection = projector.at([at[0], at[1]]);
    const found = projection && toDegrees(projection, [at[0], at[1]]);
    degrees.textContent = found ? `${found[0].toFixed(7)}, ${found[1].toFixed(7)}` : "";
  }

  function follow(x: number, y: number): void {
    hovered = stage.groundAt(x, y);
    show();
  }

  async function copy(): Promise<void> {
    if (box.hidden) return;
    await copyText(`EPSG:${srid} ${grid.textContent}\tlon, lat ${degrees.textContent}`);
    box.classList.add("copied");
    window.setTimeout(() => box.classList.remove("copied"), 1200);
  }

  let asked = false;
  stage.canvas.addEventListener("pointermove", (event) => {
    if (asked) return;
    asked = true;
    const [x, y] = [event.offsetX, event.offsetY];
    requestAnimationFrame(() => {
      if (asked) follow(x, y);
      asked = false;
    });
  });
  stage.canvas.addEventListener("pointerleave", () => {
    asked = false;
    hovered = null;
    show();
  });
  box.addEventListener("click", () => void copy());
  stage.beforeDraw(() => {
    const [x, y] = stage.pose();
    const projection = srid ? projector.at([x, y]) : null;
    const centre = projection && toDegrees(projection, [x, y]);
    const town = projection && townAt(projection, [x, y]);
    where.textContent = centre ? `${town ? `${town}\n` : ""}${centre[1].toFixed(5)}, ${centre[0].toFixed(5)}` : "";
    const pixel = pinned && stage.project(pinned);
    pin.hidden = !pixel;
    if (pixel) pin.style.transform = `translate(${pixel[0].toFixed(1)}px, ${pixel[1].toFixed(1)}px)`;
    labels.hidden = !labelled || !stage.plan;
    if (!labels.hidden) placeLabels();
  });

  /** Eastings along the lower edge, northings along the left one, also where the plan is turned. */
  function placeLabels(): void {
    const { clientWidth: width, clientHeight: height } = stage.canvas;
    const corners = [[0, 0], [0, height], [width, height]].map(([x, y]) => stage.groundAt(x ?? 0, y ?? 0));
    const [top, corner, right] = corners;
    if (!top || !corner || !right) return;
    const nodes: HTMLElement[] = [];
    for (const [axis, end, length, name] of [[0, right, width, "E"], [1, top, height, "N"]] as const) {
      const [from, to] = [corner[axis] + origin[axis], end[axis] + origin[axis]];
      const span = Math.abs(to - from);
      if (span < 1e-6) continue;
      let step = stage.gridStep;
      while ((step / span) * length < EDGE_PX) step *= step.toString().replace(/[.0]/g, "").startsWith("2") ? 2.5 : 2;
      for (let value = Math.ceil(Math.min(from, to) / step) * step; value <= Math.max(from, to); value += step) {
        const pixel = ((value - from) / (to - from)) * length;
        const node = el("span", { class: axis ? "north-label" : "east-label", textContent: `${value.toFixed(step < 1 ? 1 : 0)} ${name}` });
        node.style.transform = axis ? `translate(0, ${Math.round(height - pixel)}px)` : `translate(${Math.round(pixel)}px, 0)`;
        nodes.push(node);
      }
    }
    labels.replaceChildren(...nodes);
  }

  return {
    open(originM: Vec3, mapSrid: number): void {
      origin = originM;
      srid = mapSrid;
      show();
    },
    /** The projection arrived. */
    refresh: () => show(),
    copy: () => void copy(),
    pin(place: [number, number] | null): void {
      pinned = place && [...place, stage.ground];
      show();
      stage.draw();
    },
    labels(on: boolean): void {
      labelled = on;
      stage.draw();
    },
  };
}
