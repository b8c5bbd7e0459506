// Style of each kind of cone: a colour that is safe for colour-blind people (no red/green pair; orange is what stands now) and a marker.
import type { ChangeKind, Marking, Vec3 } from "./api";

/** `unchanged`: not among the changes. */
export type Kind = ChangeKind | "unchanged" | "standing" | "suppressed";

/** An object of any class. */
export interface Cone {
  id: string;
  category: string;
  kind: Kind;
  xyz: [number, number, number];
  /** Position before the change, of moved ones. */
  old: [number, number, number] | null;
  shift_m: number | null;
  height_m: number;
  probability: number;
  observations: number;
  /** Horizontal, along the major axis of the error ellipse; of lane markings across the line. */
  sigma_m: number;
  /** Last observation, milliseconds. */
  seenAt: number;
  /** Number of the changeset that wrote this version. */
  changeset: number;
  /** The line of a lane marking; null of point objects. */
  marking: Marking | null;
  /** Before the change, of moved lines. */
  oldLine: Vec3[] | null;
}

/** `shape` is the number of the marker in the shader and in `icon`; the colours are those of reports, images and QGIS
 * (src/conetl/exports/kind_marks.py, compared by a test), and lighter ones of the same hue for a dark page. */
export const STYLES: Record<Kind, { colour: string; dark: string; shape: number; label: string }> = {
  added: { colour: "#002e9a", dark: "#afdafb", shape: 1, label: "added" },
  moved: { colour: "#821773", dark: "#e054d9", shape: 2, label: "moved" },
  removed: { colour: "#1f2933", dark: "#e6ebf0", shape: 3, label: "removed" },
  split: { colour: "#002e9a", dark: "#afdafb", shape: 6, label: "split off" },
  merged: { colour: "#1f2933", dark: "#e6ebf0", shape: 7, label: "merged" },
  height_changed: { colour: "#006a54", dark: "#2fedaf", shape: 5, label: "height changed" },
  missed: { colour: "#8a54e4", dark: "#9b45ff", shape: 4, label: "not observed" },
  confirmed: { colour: "#7c93a2", dark: "#84a3bb", shape: 0, label: "confirmed" },
  unchanged: { colour: "#b4bcc6", dark: "#616c78", shape: 0, label: "not evaluated" },
  suppressed: { colour: "#66717c", dark: "#98a3ae", shape: 3, label: "suppressed" },
  standing: { colour: "#d64f00", dark: "#ff8c42", shape: 8, label: "standing" },
};

export const KIND_ORDER: Kind[] = ["added", "split", "moved", "removed", "merged", "height_changed", "missed", "suppressed", "confirmed", "unchanged", "standing"];

/** Gone after the drive: drawn translucent. */
export const isGone = (kind: Kind): boolean => kind === "removed" || kind === "merged" || kind === "suppressed";

const SVG = "http://www.w3.org/2000/svg";
const PATHS = [
  "M8 3.2a4.8 4.8 0 1 0 .01 0z",
  "M6.5 2h3v4.5H14v3H9.5V14h-3V9.5H2v-3h4.5z",
  "M8 1.5 14.5 8 8 14.5 1.5 8z",
  "M3.600 1.800 8 6.200l4.400-4.400 1.800 1.800L9.800 8l4.400 4.400-1.800 1.800L8 9.800l-4.400 4.400-1.800-1.800L6.200 8 1.800 3.600z",
  "M8 2.200a5.800 5.800 0 1 0 .01 0zM8 4.900a3.100 3.100 0 1 1 -.01 0z",
  "M3.200 3.200h9.600v9.600H3.200z",
  "M8 2 14 13.200H2z",
  "M8 14 2 2.800h12z",
  "M7.2 1.5h1.6l3.2 10.5h2v2.5H2V12h2z",
];

/** The marker of a kind as an icon, the same shape as in the scene. */
export const icon = (kind: Kind): SVGSVGElement => svgOf(PATHS[STYLES[kind].shape] ?? "", `var(--kind-${kind})`);

/** A path of 16 x 16. */
export function svgOf(d: string, fill: string): SVGSVGElement {
  const svg = document.createElementNS(SVG, "svg");
  svg.setAttribute("viewBox", "0 0 16 16");
  svg.setAttribute("class", "icon");
  svg.setAttribute("aria-hidden", "true");
  const path = document.createElementNS(SVG, "path");
  path.setAttribute("d", d);
  path.style.fill = fill;
  svg.append(path);
  return svg;
}
