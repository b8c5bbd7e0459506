// Classes of objects (src/conetl/model/feature_classes.py): words, glyphs and widths, and which of them the map in view has.
import { plural } from "./dom";
import { svgOf, type Cone } from "./kinds";

export const CONE = "traffic_cone";

interface ObjectClass {
  label: string;
  /** On the plan and in the legend: a path of 16 x 16. */
  glyph: string;
  /** Over the height, of the box. */
  width: number;
}

export const CLASSES = new Map<string, ObjectClass>([
  [CONE, { label: "Traffic cone", width: 0.55, glyph: "M7.2 1.5h1.6l3.2 10.5h2v2.5H2V12h2z" }],
  ["tubular_marker", { label: "Tubular marker", width: 0.3, glyph: "M6.5 1h3v11H12v3H4v-3h2.5z" }],
  ["drum", { label: "Drum", width: 0.65, glyph: "M3.5 1.8Q8 .2 12.5 1.8v12.4Q8 15.8 3.5 14.2z" }],
  ["vertical_panel", { label: "Vertical panel", width: 0.4, glyph: "M4.5 .8h7v11H14V15H2v-3.2h2.5z" }],
  ["barricade", { label: "Barricade", width: 1.2, glyph: "M.8 3h14.4v6.5h-1.7V15h-2.7V9.5H5.2V15H2.5V9.5H.8z" }],
  ["work_zone_sign", { label: "Work-zone sign", width: 1, glyph: "M8 .5 15.5 8 8 15.5.5 8z" }],
  ["arrow_board", { label: "Arrow board", width: 1.5, glyph: "M.6 5.2H8V1.5L15.4 8 8 14.5v-3.7H.6z" }],
  ["traffic_sign", { label: "Traffic sign", width: 0.9, glyph: "M8 .6a6 6 0 0 1 1.3 11.85V15.5H6.7v-3.05A6 6 0 0 1 8 .6z" }],
  ["lane_marking", { label: "Lane marking", width: 30, glyph: "M6.6 .8h2.8v6H6.6zM6.6 9.2h2.8v6H6.6z" }],
]);
/** Of maps that were imported with other categories. */
const OTHER = { width: 0.55, glyph: "M2.5 2.5h11v11h-11z" };
const NAMES = [...CLASSES.keys()];
export const GLYPHS = [...CLASSES.values(), OTHER].map((c) => c.glyph);

export const classOf = (category: string): ObjectClass => CLASSES.get(category) ?? { ...OTHER, label: category.charAt(0).toUpperCase() + category.slice(1).replaceAll("_", " ") };
/** Position in `CLASSES`, and in `GLYPHS`. */
export const classOrder = (category: string): number => (NAMES.indexOf(category) + GLYPHS.length) % GLYPHS.length;
/** "cone", "drum", as in a sentence. */
export const nounOf = (category: string): string => (category === CONE ? "cone" : classOf(category).label.toLowerCase());
export const classIcon = (category: string): SVGSVGElement => svgOf(classOf(category).glyph, "var(--soft)");

let counts = new Map<string, number>();

/** To be called with what is drawn, whatever the filters, and the numbers of what else the map has. */
export function countClasses(cones: Cone[], rest: Map<string, number>): void {
  const found = new Map([...rest].filter(([, n]) => n > 0));
  for (const { category } of cones) found.set(category, (found.get(category) ?? 0) + 1);
  counts = new Map([...found].sort(([a], [b]) => classOrder(a) - classOrder(b)));
}

/** Objects of each class in view, in the order of `CLASSES`. */
export const classCounts = (): ReadonlyMap<string, number> => counts;
export const onlyCones = (): boolean => [...counts.keys()].every((category) => category === CONE);
/** "3 cones"; "3 objects" where other classes are in view. */
export const countOf = (count: number): string => plural(count, onlyCones() ? "cone" : "object");
