// Compare two states side by side: left of a divider the first, right of it the second, in one camera.
import type { createCones } from "./cones";
import { el } from "./dom";
import type { Cone } from "./kinds";
import type { Stage } from "./scene";
import type { Swipe } from "./scene_state";

type Cones = ReturnType<typeof createCones>;
const STEP = 0.02;

export function createSwipe(stage: Stage, host: HTMLElement, ofChanges: Cones, make: () => Cones, moved: (at: number) => void) {
  const [leftName, rightName] = [el("span", { class: "side left" }), el("span", { class: "side right" })];
  const divider = el("div", { class: "swipe", tabIndex: 0, role: "slider", hidden: true,
    aria: { label: "Divider between the two states", valuemin: "0", valuemax: "100", orientation: "horizontal" } }, leftName, rightName, el("i")); // prettier-ignore
  host.append(divider);
  let sides: [Cones, Cones] | null = null;
  let shown: [Cone[], Cone[]] | null = null;
  let at: number | null = null;

  const set = (next: number) => moved(Math.round(Math.min(Math.max(next, 0), 1) * 1000) / 1000);
  divider.addEventListener("pointerdown", (event) => {
    divider.setPointerCapture(event.pointerId);
    divider.focus();
    event.preventDefault();
  });
  divider.addEventListener("pointermove", (event) => {
    if (divider.hasPointerCapture(event.pointerId)) set((event.clientX - host.getBoundingClientRect().left) / host.clientWidth);
  });
  divider.addEventListener("keydown", (event) => {
    const by = { ArrowLeft: -STEP, ArrowRight: STEP, PageDown: -5 * STEP, PageUp: 5 * STEP, Home: -1, End: 1 }[event.key];
    if (by === undefined) return;
    event.preventDefault();
    event.stopPropagation(); // the map pans with the same keys
    set((at ?? 0.5) + by);
  });

  function render(): void {
    const { renderer, scene, camera, canvas } = stage;
    const [width, height] = [canvas.clientWidth, canvas.clientHeight];
    const split = Math.round(width * (at ?? 0.5));
    const shift = stage.halfShift();
    renderer.setScissorTest(true);
    for (const i of [0, 1]) {
      sides?.forEach((side, j) => side.setVisible(i === j && shown !== null));
      renderer.setScissor(i ? split : 0, 0, i ? width - split : split, height);
      renderer.setViewport(i ? shift : -shift, 0, width, height);
      renderer.render(scene, camera);
    }
    renderer.setScissorTest(false);
    renderer.setViewport(0, 0, width, height);
  }

  return {
    /** `next`: where the divider is, or both states side by side; null: off. Until both states are there the changes are drawn. */
    show(next: Swipe | null, states: [Cone[], Cone[]] | null, names: [string, string]): void {
      const isSplit = next === "split";
      at = next === "split" ? 0.5 : next;
      stage.setSplit(isSplit);
      const on = at !== null && states !== null;
      divider.hidden = !on;
      divider.classList.toggle("fixed", isSplit);
      divider.tabIndex = isSplit ? -1 : 0;
      divider.setAttribute("role", isSplit ? "separator" : "slider");
      ofChanges.setVisible(!on);
      stage.canvas.dataset["swipe"] = on ? String(next) : "";
      if (!on && isSplit) stage.setRender(render);
      else if (!on) {
        sides?.forEach((side) => side.setVisible(false));
        stage.setRender(null);
      }
      if (!states) return void (shown = null);
      sides ??= [make(), make()];
      if (shown !== states) {
        shown = states;
        sides.forEach((side, i) => side.show(states?.[i] ?? []));
      }
      divider.style.left = `clamp(11px, ${(at ?? 0) * 100}%, 100% - 11px)`; // at the edges it can still be held
      divider.setAttribute("aria-valuenow", String(Math.round((at ?? 0) * 100)));
      divider.setAttribute("aria-valuetext", `${Math.round((at ?? 0) * 100)} %: left ${names[0]}, right ${names[1]}`);
      [leftName.textContent, rightName.textContent] = names;
      stage.setRender(render);
    },
    /** The cone under a pixel, of the state that is shown there. */
    pick(x: number, y: number): Cone | null {
      if (at === null || !sides || !shown) return ofChanges.pick(x, y);
      return sides[x < stage.canvas.clientWidth * at ? 0 : 1].pick(stage.unsplit(x), y);
    },
    /** The theme changed. */
    redraw: () => sides?.forEach((side, i) => side.show(shown?.[i] ?? [])),
  };
}
