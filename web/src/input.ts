// Mouse and keyboard.
import { MOVES_SLIDER } from "./dom";
import type { Cone } from "./kinds";
import type { Layout } from "./layout";
import { tipOf } from "./overlays";
import type { Stage } from "./scene";
import type { Tools } from "./tools";

export interface InputActions {
  select(id: string | null): void;
  /** Whether something was there besides the cones. */
  click(x: number, y: number): boolean;
  /** Keys of what covers the page: whether this one meant something; null if nothing does. */
  covering(event: KeyboardEvent, typing: boolean): boolean | null;
  /** Whether the key meant something. */
  key(event: KeyboardEvent): boolean;
}

export function listenToInput(stage: Stage, layout: Layout, tools: Tools, actions: InputActions) {
  const { canvas } = stage;
  /** The cone that the tooltip is about. */
  let hovered: Cone | null = null;
  function placeTip(): void {
    const at = hovered && stage.project(tipOf(hovered));
    layout.tip(at && hovered, ...(at ?? [0, 0]));
  }
  function hover(cone: Cone | null): void {
    hovered = cone;
    placeTip();
  }
  stage.beforeDraw(placeTip); // wherever the camera goes, it stays at its cone

  let down: [number, number] | null = null;
  canvas.addEventListener("pointerdown", (event) => {
    down = [event.clientX, event.clientY];
  });
  canvas.addEventListener("pointerup", (event) => {
    if (!down || event.button !== 0 || Math.hypot(event.clientX - down[0], event.clientY - down[1]) > 5) return;
    if (tools.click(event.offsetX, event.offsetY)) return hover(null);
    const cone: Cone | null = tools.pick(event.offsetX, event.offsetY);
    if (!cone) return actions.click(event.offsetX, event.offsetY) ? undefined : tools.clickGround(event.offsetX, event.offsetY);
    hover(null); // the panel moves the scene, and the cone away from the pointer
    actions.select(cone.id);
  });
  let hovering = false;
  canvas.addEventListener("pointermove", (event) => {
    if (hovering || event.buttons || event.pointerType === "touch") return;
    hovering = true;
    requestAnimationFrame(() => {
      hovering = false;
      const cone = tools.pick(event.offsetX, event.offsetY);
      canvas.classList.toggle("over", cone !== null);
      hover(cone);
    });
  });
  canvas.addEventListener("pointerleave", () => hover(null));

  window.addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    const target = event.target instanceof HTMLElement ? event.target : document.body;
    const typing = target.matches("select, input:not([type=range]):not([type=checkbox])");
    const covered = actions.covering(event, typing);
    if (covered !== null) {
      if (covered) event.preventDefault();
      return;
    }
    if (event.key === "Escape") {
      if (typing) target.blur();
      else if (!layout.closeHelp() && !tools.escape()) actions.select(null);
      return;
    }
    if (typing) return;
    if (target.matches("input[type=range]") && MOVES_SLIDER.test(event.key)) return;
    if (tools.key(event) || actions.key(event) || stage.key(event)) event.preventDefault();
  });

  return {
    /** These cones are drawn now: the tooltip follows, or closes. */
    shown: (cones: Cone[]) => hover(hovered && (cones.find((c) => c.id === hovered?.id) ?? null)),
  };
}
