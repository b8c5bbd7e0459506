// Base layers: LiDAR points and lane boundaries under the cones, in the paper's colours or in ones that everybody can tell apart.
import { api, type BaseLayer } from "./api";
import { createLines } from "./lines";
import { createPoints } from "./points";
import { BACKGROUND, type Stage } from "./scene";
import type { State } from "./state";

interface Palette {
  /** Of points of low and of high intensity. */
  dark: string;
  bright: string;
  line: string;
}
/** Red points, green lines: as in Lagahit & Tseng. For people who do not see red and green: docs/explanation/decisions/web.md tells how it was checked. */
export const PALETTES: Record<"paper" | "safe", Palette> = {
  paper: { dark: "#d34a4c", bright: "#fbc6be", line: "#0b8a3a" },
  safe: { dark: "#c68c3f", bright: "#e5cba8", line: "#644916" },
};

export interface BaseView {
  /** Read the layers of a map; what is drawn comes when it is there. */
  open(map: string): Promise<BaseLayer[]>;
  close(): void;
  apply(state: State): void;
}

export function createBase(stage: Stage, onTrouble: (error: unknown) => void): BaseView {
  const points = createPoints(stage, onTrouble);
  const lines = createLines(stage, BACKGROUND);
  let opening = 0;

  return {
    async open(map): Promise<BaseLayer[]> {
      const mine = ++opening;
      const [base, found] = await Promise.all([api.base(map), api.baseLines(map)]);
      if (mine !== opening) return [];
      points.setTiles(base.tiles, (sha256) => api.baseTile(map, sha256));
      lines.show(found.lines);
      stage.warm();
      document.documentElement.dataset["lines"] = String(found.lines.length);
      if (base.truncated || found.truncated) onTrouble(new Error("The base layers are larger than one page holds: some of them are not shown."));
      return base.layers;
    },
    close(): void {
      opening += 1;
      points.setTiles([], () => Promise.reject(new Error("no map")));
      lines.show([]);
    },
    apply(state): void {
      const palette = PALETTES[state.safeColours ? "safe" : "paper"];
      points.setColour(palette.dark, palette.bright);
      lines.setColour(palette.line);
      points.setVisible(state.points);
      lines.setVisible(state.lines);
    },
  };
}
