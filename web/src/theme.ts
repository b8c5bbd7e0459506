// Light and dark: the system's choice unless the person chose otherwise. It is theirs, so it is kept in this browser, not in links.
import { el } from "./dom";
import { KIND_ORDER, STYLES, type Kind } from "./kinds";
import "./theme.css";

/** What the scene draws with; the rest of the page takes its colours from theme.css. */
export interface Colours {
  background: string;
  gridMinor: string;
  gridMajor: string;
  path: string;
  camera: string;
  ellipse: string;
  /** Of LiDAR points with low and with high intensity; muted, so that cones come first. */
  dark: string;
  bright: string;
  /** Of LiDAR points on the ground, half way up, and from 6 m on. */
  heights: [string, string, string];
  line: string;
  /** Around the markers. */
  halo: string;
  /** Around lane markings, so that white paint is seen on a light page. */
  rim: string;
}

export const COLOURS: Record<"light" | "dark", Colours> = {
  light: {
    background: "#eef1f4", gridMinor: "#dde2e8", gridMajor: "#c3cbd4", path: "#4a5560", camera: "#00795c", ellipse: "#0068b4",
    dark: "#a9a294", bright: "#dcd7cc", heights: ["#cfc9bd", "#7fa3b5", "#3b5c8a"], line: "#8a7443", halo: "#ffffff", rim: "#5c6670",
  },
  dark: {
    background: "#12181f", gridMinor: "#1d252e", gridMajor: "#2c3742", path: "#9fabb7", camera: "#3fc79f", ellipse: "#5fb4ee",
    dark: "#393d40", bright: "#76746c", heights: ["#4c4f52", "#4f7f97", "#9cc4ea"], line: "#a58f5c", halo: "#0b0f14", rim: "#0b0f14",
  },
}; // prettier-ignore

/** As in Figure 6 of Lagahit & Tseng: LiDAR red, lane boundaries green, the new cone blue. */
const PAPER = {
  light: { dark: "#eeb4ae", bright: "#c2281d", line: "#12833a", added: "#0a45d6" },
  dark: { dark: "#6e1d18", bright: "#f2564a", line: "#37d067", added: "#5d92ff" },
};

const KEY = "conetl-theme";
const system = window.matchMedia("(prefers-color-scheme: dark)");
const callbacks: (() => void)[] = [];
let choice = read();

function read(): string | null {
  try {
    return localStorage.getItem(KEY);
  } catch {
    return null; // storage is switched off: the system decides
  }
}

const isDark = () => (choice === null ? system.matches : choice === "dark");

let paper = false;
const ofPaper = () => (paper ? PAPER[isDark() ? "dark" : "light"] : null);
export const colours = (): Colours => ({ ...COLOURS[isDark() ? "dark" : "light"], ...ofPaper() });
/** Of the bodies of new cones; null: their own paint. */
export const newPaint = (): string | null => ofPaper()?.added ?? null;
export const colourOf = (kind: Kind): string => (kind === "added" && newPaint()) || (isDark() ? STYLES[kind].dark : STYLES[kind].colour);
/** The colour of a kind for an element's style: it follows the theme. */
export const colourVariable = (kind: Kind) => `var(--kind-${kind})`;

/** Called after every change of the theme. */
export const onTheme = (callback: () => void) => void callbacks.push(callback);

function apply(): void {
  const root = document.documentElement;
  root.dataset["theme"] = isDark() ? "dark" : "light";
  for (const [name, value] of [["--points", colours().dark], ["--lines", colours().line]] as const) root.style.setProperty(name, value);
  for (const kind of KIND_ORDER) root.style.setProperty(`--kind-${kind}`, colourOf(kind));
  for (const callback of callbacks) callback();
}

/** The colours of the paper, or those of the map viewer. */
export function setPaper(on: boolean): void {
  if (on === paper) return;
  paper = on;
  apply();
}

/** Switches to the other one; choosing what the system has follows the system again. */
export function themeSwitch(): HTMLButtonElement {
  const button = el("button", { type: "button", class: "link theme", id: "theme" });
  const show = () => {
    button.textContent = isDark() ? "Light" : "Dark";
    button.title = isDark() ? "Switch to light colours" : "Switch to dark colours";
  };
  button.addEventListener("click", () => {
    const next = isDark() ? "light" : "dark";
    choice = (next === "dark") === system.matches ? null : next;
    try {
      if (choice === null) localStorage.removeItem(KEY);
      else localStorage.setItem(KEY, choice);
    } catch {
      // it holds until the page is closed
    }
    apply();
  });
  onTheme(show);
  show();
  return button;
}

system.addEventListener("change", apply);
apply();
