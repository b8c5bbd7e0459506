// The whole map in a corner while the view shows a small part of it; a click or a drag there moves the view.
import { el } from "./dom";
import { footprint } from "./basemap";
import type { Cone } from "./kinds";
import type { Pair } from "./lonlat";
import type { Stage } from "./scene";
import { colourOf, colours } from "./theme";

const [WIDTH, HEIGHT, MARGIN] = [168, 116, 8];
/** Shown if the map is this many times wider or higher than what is seen of it. */
const LARGER = 3;

export function createMinimap(stage: Stage, host: HTMLElement) {
  const canvas = el("canvas", { class: "minimap-canvas", width: 2 * WIDTH, height: 2 * HEIGHT });
  const box = el("div", { class: "minimap", hidden: true, title: "Overview: click to move the view", aria: { hidden: "true" } }, canvas);
  host.append(box);
  const back = el("canvas", { width: canvas.width, height: canvas.height });
  let cones: Pick<Cone, "kind" | "xyz">[] = [];
  let [left, bottom, right, top] = [0, 0, 0, 0];
  let scale = 1;
  let dirty = true;

  const x = (e: number) => MARGIN + (e - left) * scale + (WIDTH - 2 * MARGIN - (right - left) * scale) / 2;
  const y = (n: number) => HEIGHT - MARGIN - (n - bottom) * scale - (HEIGHT - 2 * MARGIN - (top - bottom) * scale) / 2;

  function drawBack(): void {
    const c = back.getContext("2d");
    dirty = false;
    if (!c) return;
    c.setTransform(2, 0, 0, 2, 0, 0);
    c.clearRect(0, 0, WIDTH, HEIGHT);
    for (const cone of cones) {
      c.fillStyle = colourOf(cone.kind);
      c.fillRect(x(cone.xyz[0]) - 1, y(cone.xyz[1]) - 1, 2, 2);
    }
  }

  stage.beforeDraw(() => {
    // The middle line of the view is the least that is seen of the ground.
    const least = stage.canvas.clientWidth / stage.pixelsAtDepth(stage.pose()[5]);
    const seen = Math.max(right - left, top - bottom) > LARGER * Math.min(least, (least * stage.canvas.clientHeight) / stage.canvas.clientWidth) ? footprint(stage) : [];
    const [wide, high] = [spread(seen.map((p) => p[0])), spread(seen.map((p) => p[1]))];
    box.hidden = seen.length < 3 || (right - left < LARGER * wide && top - bottom < LARGER * high);
    const context = box.hidden ? null : canvas.getContext("2d"); // made when it is first needed: that takes a while
    if (!context) return;
    if (dirty) drawBack();
    context.setTransform(1, 0, 0, 1, 0, 0);
    context.clearRect(0, 0, canvas.width, canvas.height);
    context.drawImage(back, 0, 0);
    context.setTransform(2, 0, 0, 2, 0, 0);
    context.strokeStyle = colours().ellipse;
    context.lineWidth = 1.5;
    const [px, py] = [x(middle(seen, 0)), y(middle(seen, 1))];
    context.beginPath();
    if (wide * scale < 6) context.arc(px, py, 5, 0, 2 * Math.PI); // a speck could not be seen
    else seen.forEach((p, i) => (i ? context.lineTo(x(p[0]), y(p[1])) : context.moveTo(x(p[0]), y(p[1]))));
    context.closePath();
    context.stroke();
  });

  const go = (event: PointerEvent) => {
    const [, , z, theta, phi, radius] = stage.pose();
    const [px, py] = [event.offsetX, event.offsetY];
    stage.setPose([left + (px - x(left)) / scale, bottom - (py - y(bottom)) / scale, z, theta, phi, radius]);
  };
  box.addEventListener("pointerdown", (event) => {
    box.setPointerCapture(event.pointerId);
    go(event);
  });
  box.addEventListener("pointermove", (event) => event.buttons && go(event));

  return {
    show(next: Pick<Cone, "kind" | "xyz">[]): void {
      cones = next;
      const [e, n] = [cones.map((c) => c.xyz[0]), cones.map((c) => c.xyz[1])];
      [left, right, bottom, top] = [...ends(e), ...ends(n)];
      scale = Math.min((WIDTH - 2 * MARGIN) / Math.max(right - left, 1), (HEIGHT - 2 * MARGIN) / Math.max(top - bottom, 1));
      dirty = true;
    },
  };
}

const ends = (values: number[]): Pair => values.reduce<Pair>(([a, b], v) => [Math.min(a, v), Math.max(b, v)], [Infinity, -Infinity]);
const spread = (values: number[]) => ends(values)[1] - ends(values)[0];
const middle = (pairs: Pair[], axis: 0 | 1) => pairs.reduce((sum, p) => sum + p[axis], 0) / pairs.length;
