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

export function plural(count: number, one: string, many = `${one}s`): string {
  return `${count.toLocaleString("en")} ${count === 1 ? one : many}`;
}

/** Three decimals that never read as certainty; the same in src/conetl/mapping/reasons.py. */
export const probabilityText = (p: number): string => (p < 0.0005 ? "<0.001" : p >= 0.9995 ? ">0.999" : p.toFixed(3));

/** Which state of the database; null is the newest. */
export const knownText = (known: string | null): string => (known === null ? "as known now" : `as known at ${utc(known)} UTC`);

export const messageOf = (error: unknown) => (error instanceof Error ? error.message : String(error));

export const shortId = (id: string) => id.slice(0, 8);
