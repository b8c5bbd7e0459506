// In the panel: why the cone is as it is, and of a removed or missed one the images in which its position was visible and empty.
import type { HistoryItem } from "./api";
import { el, fill, plural } from "./dom";
import { createFrameCache } from "./frame_cache";
import { createPane, type Picture } from "./image_pane";
import { bestFrame, judging, type PassFrame, type Side } from "./judging";
import { isGone } from "./kinds";
import { outlineOf, project, type Point } from "./projection";
import type { Start } from "./viewer";

const SIDES: Side[] = ["left", "right"];
/** Of the pane's height that the cone takes. */
const SHARE = 0.36;
const PANE_PX = 168;

/** The sentence; `unknown` is shown where the cone has no state yet. */
export function sentenceOf(now: HistoryItem): HTMLElement {
  return el("p", { class: isGone(now.kind) || now.kind === "missed" ? "why gone" : "why", textContent: now.why });
}

export function createEmptyPosition(host: HTMLElement, open: (start: Start) => void) {
  const cache = createFrameCache();
  const panes = SIDES.map(() => createPane(null));
  let key = "";
  let frames: PassFrame[] = [];
  let at = 0;

  async function showFrame(map: string, id: string, now: HistoryItem): Promise<void> {
    const wanted = frames[at];
    if (!wanted) return;
    const mine = key;
    const frame = await cache.frame(map, now.drive_uuid, wanted.frame_index);
    const images = await Promise.all(SIDES.map((side) => cache.image(map, frame, side, id)));
    if (mine !== key || wanted !== frames[at]) return;
    SIDES.forEach((side, i) => {
      const own = frame[side];
      const outline = outlineOf(own, now) ?? [];
      const middle: Point = project(own, [now.xyz_m[0], now.xyz_m[1], now.xyz_m[2] + (now.object_height_m ?? 0) / 2]) ?? [0, 0];
      const rows = outline.map(([, v]) => v);
      const picture: Picture = {
        ...(images[i] ?? { url: null, problem: null }), size: [own.width_px, own.height_px], anchor: middle, caption: side,
        alt: `${side} image of frame pair ${frame.frame_index}: the position without a cone`,
        shapes: [{ points: outline, style: "cone dashed" }],
      }; // prettier-ignore
      panes[i]?.show(picture, { scale: (SHARE * PANE_PX) / Math.max(Math.max(...rows) - Math.min(...rows), 4), offset: [0, 0] });
    });
    host.dataset["frame"] = String(frame.frame_index);
  }

  function draw(map: string, id: string, now: HistoryItem): void {
    const frame = frames[at];
    if (!frame) return fill(host, el("h3", { textContent: "Position without a cone" }), el("p", { class: "hint", textContent: "The frame pairs of this drive were deleted." }));
    const focus = document.activeElement instanceof HTMLElement && host.contains(document.activeElement) ? document.activeElement.dataset["focus"] : undefined;
    const go = (to: number) => {
      at = Math.min(Math.max(to, 0), frames.length - 1);
      draw(map, id, now);
    };
    const slider = el("input", { type: "range", min: "0", max: String(frames.length - 1), step: "1", value: String(at), data: { focus: "slider" }, aria: { label: "Frame pair without a cone" } });
    slider.addEventListener("input", () => go(Number(slider.value)));
    const step = (to: number, text: string, label: string) =>
      el("button", { type: "button", class: "step", textContent: text, disabled: to < 0 || to >= frames.length, data: { focus: label }, aria: { label }, onclick: () => go(to) });
    const larger = el("button", { type: "button", class: "crop", title: "Open the images (I)", onclick: () => open({ drive_uuid: now.drive_uuid, frame_index: frame.frame_index }) },
      el("span", { class: "panes", data: { columns: "2" } }, ...panes.map((p) => p.node))); // prettier-ignore
    fill(host, el("h3", { textContent: `Position without a cone: ${plural(frames.length, "frame pair")}` }), larger,
      el("div", { class: "stepper" }, step(at - 1, "‹", "Previous frame pair without a cone"), slider, step(at + 1, "›", "Next frame pair without a cone")),
      el("p", { class: "hint", textContent: `${now.drive_id} · frame pair ${frame.frame_index} · ${frame.range_m.toFixed(1)} m away · dashed: position on the map` })); // prettier-ignore
    if (focus) host.querySelector<HTMLElement>(`[data-focus="${focus}"]:not(:disabled)`)?.focus();
    void showFrame(map, id, now).catch(() => undefined); // its panes say what is missing
  }

  return async (map: string, id: string, now: HistoryItem | undefined): Promise<void> => {
    host.hidden = !now || !(now.kind === "removed" || now.kind === "missed");
    const wanted = now && !host.hidden ? `${map} ${id} ${now.version} ${now.drive_uuid}` : "";
    if (wanted === key) return;
    key = wanted;
    if (!now || !key) return;
    fill(host, el("h3", { textContent: "Position without a cone" }), el("p", { class: "hint loading", textContent: "Loading …" }));
    try {
      const { passes } = await judging.passes(map, id, now.version);
      if (key !== wanted) return;
      const pass = passes.find((p) => p.drive_uuid === now.drive_uuid);
      frames = (pass?.frames ?? []).filter((f) => f.state === "empty");
      at = Math.max(frames.indexOf((pass && bestFrame({ ...pass, frames })) as PassFrame), 0);
      draw(map, id, now);
    } catch (error) {
      if (key !== wanted) return;
      key = "";
      fill(host, el("h3", { textContent: "Position without a cone" }), el("p", { class: "hint bad", textContent: error instanceof Error ? error.message : String(error) }));
    }
  };
}
