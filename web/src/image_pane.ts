// One image with its overlay, zoomed and panned together with its neighbours. The overlay is drawn in screen pixels, so lines and
// numbers keep their size at every zoom.
import { el, fill } from "./dom";
import type { Point } from "./projection";

export interface Shape {
  points: Point[];
  /** Class of the line in viewer.css. */
  style: string;
  closed?: boolean;
  text?: string;
}

export interface Picture {
  url: string | null;
  /** Why there is no image. */
  problem: string | null;
  size: Point;
  alt: string;
  caption: string;
  /** The point that stays in place while frames change. */
  anchor: Point;
  shapes: Shape[];
}

/** Zoom (screen pixels per image pixel; null fits the image) and offset of the middle from the anchor (image pixels). */
export interface View {
  scale: number | null;
  offset: Point;
}

export interface PaneActions {
  /** A new view for all panes. */
  view(view: View): void;
  /** A click on a point of the image. */
  pick(point: Point): void;
}

const SVG = "http://www.w3.org/2000/svg";
const MOST = 64;
const WHEEL = 0.0016;

export interface Pane {
  node: HTMLElement;
  show(picture: Picture, view: View): void;
  setView(view: View): void;
  zoom(factor: number): void;
  /** Scale at which the whole image fits. */
  fit(): number;
  pan(dx: number, dy: number): void;
}

export function createPane(actions: PaneActions | null): Pane {
  const image = el("img", { draggable: false });
  const overlay = document.createElementNS(SVG, "svg");
  overlay.setAttribute("aria-hidden", "true");
  const problem = el("p", { class: "pane-problem", hidden: true });
  const caption = el("figcaption", {});
  const node = el("figure", { class: "pane" }, image, overlay as unknown as HTMLElement, problem, caption);
  let picture: Picture | null = null;
  let view: View = { scale: null, offset: [0, 0] };

  const fitScale = () => (picture ? Math.min(node.clientWidth / picture.size[0], node.clientHeight / picture.size[1]) : 1) || 1;
  const scaleOf = () => view.scale ?? fitScale();

  function middle(): Point {
    if (!picture) return [0, 0];
    if (view.scale === null) return [picture.size[0] / 2, picture.size[1] / 2];
    return [within(0, node.clientWidth), within(1, node.clientHeight)];
  }

  /** No border is left empty that the image can fill. */
  function within(axis: 0 | 1, screen: number): number {
    if (!picture) return 0;
    const [size, half] = [picture.size[axis], screen / scaleOf() / 2];
    return size < 2 * half ? size / 2 : Math.min(Math.max(picture.anchor[axis] + view.offset[axis], half), size - half);
  }

  /** From image to screen. */
  function toScreen([u, v]: Point): Point {
    const [scale, [mu, mv]] = [scaleOf(), middle()];
    return [(u - mu) * scale + node.clientWidth / 2, (v - mv) * scale + node.clientHeight / 2];
  }

  function toImage(x: number, y: number): Point {
    const [scale, [mu, mv]] = [scaleOf(), middle()];
    return [(x - node.clientWidth / 2) / scale + mu, (y - node.clientHeight / 2) / scale + mv];
  }

  function draw(): void {
    if (!picture || !node.clientWidth) return;
    const [x, y] = toScreen([0, 0]);
    const scale = scaleOf();
    image.style.transform = `translate(${x}px, ${y}px) scale(${scale})`;
    image.classList.toggle("pixels", scale >= 3);
    overlay.replaceChildren(...picture.shapes.flatMap(shape));
  }

  function shape({ points, style, closed = true, text }: Shape): SVGElement[] {
    const at = points.map(toScreen);
    const path = at.map(([px, py], i) => `${i ? "L" : "M"}${px.toFixed(1)} ${py.toFixed(1)}`).join("") + (closed ? "Z" : "");
    const lines = ["rim", style].map((name) => {
      const line = document.createElementNS(SVG, "path");
      line.setAttribute("d", path);
      line.setAttribute("class", name);
      return line;
    });
    if (!text) return lines;
    const label = document.createElementNS(SVG, "text");
    const [left, top] = [Math.min(...at.map((p) => p[0])), Math.min(...at.map((p) => p[1]))];
    label.setAttribute("x", left.toFixed(1));
    label.setAttribute("y", (top > 16 ? top - 5 : top + 14).toFixed(1));
    label.setAttribute("class", style);
    if (left > 0.8 * node.clientWidth) label.setAttribute("text-anchor", "end");
    label.textContent = text;
    return [...lines, label];
  }

  /** Zoom about a point of the screen. */
  function zoomAt(factor: number, x: number, y: number): void {
    if (!picture || !actions) return;
    const [before, [u, v]] = [scaleOf(), toImage(x, y)];
    const scale = Math.min(Math.max(before * factor, fitScale()), MOST);
    if (scale <= fitScale() * 1.001 && factor < 1) return actions.view({ scale: null, offset: [0, 0] });
    const [cu, cv] = [u - (x - node.clientWidth / 2) / scale, v - (y - node.clientHeight / 2) / scale];
    actions.view({ scale, offset: [cu - picture.anchor[0], cv - picture.anchor[1]] });
  }

  function pan(dx: number, dy: number): void {
    if (!picture || !actions) return;
    const [scale, [mu, mv]] = [scaleOf(), middle()];
    actions.view({ scale, offset: [mu - dx / scale - picture.anchor[0], mv - dy / scale - picture.anchor[1]] });
  }

  if (actions) listen(node, { zoomAt, pan, pick: (x, y) => actions.pick(toImage(x, y)) });
  new ResizeObserver(draw).observe(node);

  return {
    node,
    show(next: Picture, nextView: View): void {
      picture = next;
      view = nextView;
      if (next.url !== null && image.getAttribute("src") !== next.url) image.src = next.url;
      image.hidden = next.url === null;
      image.alt = next.alt;
      image.width = next.size[0];
      image.height = next.size[1];
      problem.hidden = next.problem === null;
      problem.textContent = next.problem ?? "";
      fill(caption, next.caption);
      draw();
    },
    setView(next: View): void {
      view = next;
      draw();
    },
    zoom: (factor) => zoomAt(factor, node.clientWidth / 2, node.clientHeight / 2),
    fit: fitScale,
    pan,
  };
}

interface Gestures {
  zoomAt(factor: number, x: number, y: number): void;
  pan(dx: number, dy: number): void;
  pick(x: number, y: number): void;
}

/** Wheel, drag, pinch, click. */
function listen(node: HTMLElement, { zoomAt, pan, pick }: Gestures): void {
  const down = new Map<number, Point>();
  let travelled = 0;
  const at = (event: MouseEvent): Point => {
    const box = node.getBoundingClientRect();
    return [event.clientX - box.left, event.clientY - box.top];
  };
  node.addEventListener("wheel", (event) => {
    event.preventDefault();
    zoomAt(Math.exp(-event.deltaY * WHEEL * (event.deltaMode === 1 ? 30 : 1)), ...at(event));
  }, { passive: false }); // prettier-ignore
  node.addEventListener("pointerdown", (event) => {
    if (event.button !== 0) return;
    node.setPointerCapture(event.pointerId);
    if (!down.size) travelled = 0;
    down.set(event.pointerId, at(event));
  });
  node.addEventListener("pointermove", (event) => {
    const last = down.get(event.pointerId);
    if (!last) return;
    const now = at(event);
    const [dx, dy] = [now[0] - last[0], now[1] - last[1]];
    travelled += Math.hypot(dx, dy);
    const other = [...down].find(([id]) => id !== event.pointerId)?.[1];
    down.set(event.pointerId, now);
    if (other) {
      const apart = (p: Point) => Math.hypot(p[0] - other[0], p[1] - other[1]) || 1;
      pan(dx / 2, dy / 2);
      zoomAt(apart(now) / apart(last), (now[0] + other[0]) / 2, (now[1] + other[1]) / 2);
    } else if (travelled > 3) pan(dx, dy);
  });
  for (const type of ["pointerup", "pointercancel"] as const)
    node.addEventListener(type, (event) => {
      const was = down.delete(event.pointerId);
      if (was && type === "pointerup" && !down.size && travelled <= 3) pick(...at(event));
    });
  node.addEventListener("dblclick", (event) => zoomAt(2, ...at(event)));
}
