// Small helpers for making elements. Text is only ever set as text, never parsed as HTML.

type Child = Node | string | null | undefined | false;
type Props<K extends keyof HTMLElementTagNameMap> = Partial<Omit<HTMLElementTagNameMap[K], "style" | "dataset">> & {
  class?: string;
  data?: Record<string, string>;
  aria?: Record<string, string>;
  role?: string;
};

export function el<K extends keyof HTMLElementTagNameMap>(
  tag: K,
  props: Props<K> = {},
  ...children: Child[]
): HTMLElementTagNameMap[K] {
  const node = document.createElement(tag);
  const { class: className, data, aria, role, ...rest } = props;
  if (className) node.className = className;
  if (role) node.setAttribute("role", role);
  for (const [name, value] of Object.entries(data ?? {})) node.dataset[name] = value;
  for (const [name, value] of Object.entries(aria ?? {})) node.setAttribute(`aria-${name}`, value);
  Object.assign(node, rest);
  for (const child of children) if (child) node.append(child);
  return node;
}

/** A part that a button opens, and that the button, and Esc close. Returns what opens and closes it. */
export function popup(button: HTMLButtonElement, part: HTMLElement, opened: () => void = () => undefined): (on: boolean) => void {
  const open = (on: boolean) => {
    part.hidden = !on;
    button.setAttribute("aria-expanded", String(on));
    if (on) opened();
  };
  button.addEventListener("click", () => open(part.hidden));
  for (const node of [button, part])
    node.addEventListener("keydown", (event) => {
      if (event.key !== "Escape" || part.hidden) return;
      event.stopPropagation();
      open(false);
      button.focus();
    });
  return open;
}

/** Keys of a slider that has the focus. */
export const MOVES_SLIDER = /^(Arrow|Home|End|Page)/;

export function fill(node: Element, ...children: Child[]): void {
  node.replaceChildren(...children.filter((child): child is Node | string => Boolean(child)));
}

const two = (n: number) => String(n).padStart(2, "0");

/** "2026-03-02 09:41:07" in UTC; with `seconds` false to the minute. */
export function utc(iso: string, seconds = true): string {
  const t = new Date(iso);
  const day = `${t.getUTCFullYear()}-${two(t.getUTCMonth() + 1)}-${two(t.getUTCDate())}`;
  return `${day} ${two(t.getUTCHours())}:${two(t.getUTCMinutes())}${seconds ? `:${two(t.getUTCSeconds())}` : ""}`;
}

const LOCAL = new Intl.DateTimeFormat("en-GB", { day: "2-digit", month: "short", hour: "2-digit", minute: "2-digit", timeZoneName: "short" });
const CLOCK = new Intl.DateTimeFormat("en-GB", { hour: "2-digit", minute: "2-digit", timeZoneName: "short" });

/** As `utc`, with the zone, and the time where the reader is, if it is another one. */
export function when(iso: string, seconds = true): string {
  const t = new Date(iso);
  const here = t.getTimezoneOffset() === 0 ? "" : ` (${(t.getDate() === t.getUTCDate() ? CLOCK : LOCAL).format(t)})`;
  return `${utc(iso, seconds)} UTC${here}`;
}

export function plural(count: number, one: string, many = `${one}s`): string {
  return `${count.toLocaleString("en")} ${count === 1 ? one : many}`;
}

/** Three decimals that never read as certainty; the same in src/conetl/mapping/reasons.py. */
export const probabilityText = (p: number): string => (p < 0.0005 ? "<0.001" : p >= 0.9995 ? ">0.999" : p.toFixed(3));

/** The existence probability in words for everybody; never certainty. The same in src/conetl/mapping/reasons.py. */
export const sureText = (p: number): string => (p < 0.005 ? "<1 %" : p >= 0.995 ? ">99 %" : `${(100 * p).toFixed(0)} %`);

/** A sigma in the unit in which people say it; the same in src/conetl/mapping/reasons.py. */
export const lengthText = (m: number): string => (m < 0.0095 ? `${(1000 * m).toFixed(0)} mm` : m < 0.995 ? `${(100 * m).toFixed(0)} cm` : `${m.toFixed(1)} m`);

/** Which state of the database; null is the newest. */
export const knownText = (known: string | null): string => (known === null ? "as known now" : `as known at ${when(known)}`);

export const messageOf = (error: unknown) => (error instanceof Error ? error.message : String(error));

export const shortId = (id: string) => id.slice(0, 8);
