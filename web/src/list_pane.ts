// Between view and timeline: a pane of lists in tabs. Other modules add their tab with `addTab`.
import { el, plural } from "./dom";

export interface Tab {
  /** Number beside the name, or beside another word; null hides it. */
  count(number: number | null, called?: string): void;
  /** Open the pane at this tab. */
  show(): void;
  /** Draw it again now if it is visible, else when it is opened. */
  redraw(): void;
  /** Whether it is what the pane shows. */
  readonly visible: boolean;
}

interface Entry {
  id: string;
  button: HTMLButtonElement;
  host: HTMLElement;
  render: (host: HTMLElement) => void;
  stale: boolean;
}

export interface ListPane {
  /** `render` fills the tab's element, which is its own and stays; it is called when the tab is visible and stale. */
  addTab(name: string, render: (host: HTMLElement) => void): Tab;
  /** Open the pane at the tab with this id (its name in lower case), or close it with null. Unknown ids open the first tab. */
  open(id: string | null): void;
  toggle(): void;
  readonly opened: string | null;
  /** Called with the id of the opened tab after each change by the person; null: closed. */
  onChange(callback: (id: string | null) => void): void;
}

const [LEAST_PX, STEP_PX] = [120, 32];
/** The view keeps at least this share of the window's height. */
const MOST_SHARE = 0.75;

/** `host` is the pane; `toggleButton` opens and closes it. */
export function createListPane(host: HTMLElement, toggleButton: HTMLButtonElement): ListPane {
  const entries: Entry[] = [];
  const callbacks: ((id: string | null) => void)[] = [];
  let last: string | null = null;
  let opened: string | null = null;

  const tabs = el("div", { class: "list-tabs", role: "tablist", aria: { label: "Lists" } });
  const grip = el("div", { class: "list-grip", role: "separator", tabIndex: 0, title: "Drag, or press ↑ ↓, to change the height",
    aria: { orientation: "horizontal", label: "Height of the list", valuemin: String(LEAST_PX), valuenow: "264" } }); // prettier-ignore
  const close = el("button", { type: "button", class: "close", textContent: "×", title: "Close the list (L)", aria: { label: "Close the list" }, onclick: () => choose(null) });
  const head = el("div", { class: "list-head" }, tabs, el("span", { class: "space" }), close);
  const bodies = el("div", { class: "list-bodies" });
  host.append(grip, head, bodies);

  function apply(id: string | null): void {
    opened = id === null ? null : (entries.find((e) => e.id === id) ?? entries[0])?.id ?? null;
    if (opened !== null) last = opened;
    host.hidden = opened === null;
    toggleButton.setAttribute("aria-expanded", String(opened !== null));
    for (const entry of entries) {
      const chosen = entry.id === opened;
      entry.button.setAttribute("aria-selected", String(chosen));
      entry.button.tabIndex = chosen ? 0 : -1;
      entry.host.hidden = !chosen;
      if (chosen) drawIfStale(entry);
    }
  }

  function choose(id: string | null): void {
    const before = opened;
    apply(id);
    if (opened !== before) for (const callback of callbacks) callback(opened);
  }

  function drawIfStale(entry: Entry): void {
    if (!entry.stale) return;
    entry.stale = false;
    entry.render(entry.host);
  }

  tabs.addEventListener("keydown", (event) => {
    const at = entries.findIndex((e) => e.id === opened);
    const by = event.key === "ArrowRight" ? 1 : event.key === "ArrowLeft" ? -1 : 0;
    const next = by ? entries[(at + by + entries.length) % entries.length] : undefined;
    if (!next) return;
    event.preventDefault();
    event.stopPropagation();
    choose(next.id);
    next.button.focus();
  });

  function setHeight(px: number): void {
    const height = Math.round(Math.min(Math.max(px, LEAST_PX), window.innerHeight * MOST_SHARE));
    host.style.setProperty("--list-height", `${height}px`);
    grip.setAttribute("aria-valuenow", String(height));
  }
  grip.addEventListener("pointerdown", (event) => {
    grip.setPointerCapture(event.pointerId);
    const [from, height] = [event.clientY, host.offsetHeight];
    const move = (e: PointerEvent) => setHeight(height + from - e.clientY);
    grip.addEventListener("pointermove", move);
    grip.addEventListener("lostpointercapture", () => grip.removeEventListener("pointermove", move), { once: true });
  });
  grip.addEventListener("keydown", (event) => {
    const by = event.key === "ArrowUp" ? STEP_PX : event.key === "ArrowDown" ? -STEP_PX : 0;
    if (!by) return;
    event.preventDefault();
    event.stopPropagation();
    setHeight(host.offsetHeight + by);
  });

  const pane: ListPane = {
    addTab(name, render) {
      const id = name.toLowerCase();
      const count = el("span", { class: "list-count" });
      const button = el("button", { type: "button", role: "tab", id: `list-tab-${id}`, onclick: () => choose(id), aria: { selected: "false", controls: `list-${id}` } }, name, count);
      button.tabIndex = -1;
      const body = el("div", { class: "list-body", id: `list-${id}`, role: "tabpanel", hidden: true, aria: { labelledby: button.id } });
      const entry: Entry = { id, button, host: body, render, stale: true };
      entries.push(entry);
      tabs.append(button);
      bodies.append(body);
      return {
        count: (number, called = name) => {
          if (button.firstChild) button.firstChild.nodeValue = called;
          count.textContent = number === null ? "" : number.toLocaleString("en");
          button.title = number === null ? "" : plural(number, "row");
        },
        show: () => choose(id),
        redraw: () => {
          entry.stale = true;
          if (opened === id) drawIfStale(entry);
        },
        get visible() {
          return opened === id;
        },
      };
    },
    open: apply,
    toggle: () => choose(opened === null ? last ?? entries[0]?.id ?? null : null),
    get opened() {
      return opened;
    },
    onChange: (callback) => void callbacks.push(callback),
  };
  toggleButton.addEventListener("click", () => pane.toggle());
  apply(null);
  return pane;
}
