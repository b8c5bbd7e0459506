// The search field of the header: cones, drives, days, towns and coordinates in one list, and the marker of a position.
import type { Found, FoundPosition } from "./api";
import { el, fill, messageOf, shortId, utc } from "./dom";
import type { Stage } from "./scene";

export interface SearchActions {
  search(text: string): Promise<Found>;
  select(id: string): void;
  showChangeset(no: number): void;
  flyTo(position: FoundPosition): void;
}

const REST_MS = 200;

interface Option {
  group: string;
  text: string;
  detail: string;
  run: () => void;
}

export function createSearch(host: HTMLElement, actions: SearchActions) {
  let options: Option[] = [];
  let active = -1;
  let timer = 0;
  let asked = 0;
  const list = el("div", { class: "search-list", id: "search-list", role: "listbox", hidden: true, aria: { label: "Search results" } });
  const status = el("p", { class: "search-status hint", role: "status", hidden: true });
  const popup = el("div", { class: "search-popup", hidden: true }, status, list);
  const input = el("input", {
    id: "search", type: "search", placeholder: "Search cone, drive, date, town, coordinates", autocomplete: "off", spellcheck: false, maxLength: 100, role: "combobox",
    aria: { label: "Search for the id of a cone, a drive, a date, a town or coordinates", expanded: "false", controls: "search-list", autocomplete: "list" },
  }); // prettier-ignore
  const form = el("form", { class: "search", role: "search" }, input, el("kbd", { textContent: "/" }), popup);
  host.append(form);

  input.addEventListener("input", () => {
    window.clearTimeout(timer);
    if (!input.value.trim()) return close();
    timer = window.setTimeout(() => void run(false), REST_MS);
  });
  form.addEventListener("submit", (event) => {
    event.preventDefault();
    window.clearTimeout(timer);
    const chosen = options[active];
    if (chosen && !popup.hidden) choose(chosen);
    else void run(true);
  });
  input.addEventListener("keydown", (event) => {
    if (event.key === "Escape") return close();
    const by = event.key === "ArrowDown" ? 1 : event.key === "ArrowUp" ? -1 : 0;
    if (!by || !options.length) return;
    event.preventDefault();
    popup.hidden = false;
    activate((active + by + options.length) % options.length);
  });
  form.addEventListener("focusout", (event) => {
    if (!(event.relatedTarget instanceof Node && form.contains(event.relatedTarget))) close();
  });

  function close(): void {
    asked += 1;
    popup.hidden = true;
    options = [];
    active = -1;
    input.setAttribute("aria-expanded", "false");
    input.removeAttribute("aria-activedescendant");
  }

  function choose(option: Option): void {
    close();
    input.blur();
    option.run();
  }

  function say(text: string, bad = false): void {
    popup.hidden = false;
    status.hidden = !text;
    status.textContent = text;
    status.classList.toggle("bad", bad);
  }

  function activate(index: number): void {
    active = index;
    list.querySelectorAll("[role=option]").forEach((node, i) => {
      node.setAttribute("aria-selected", String(i === index));
      if (i === index) node.scrollIntoView({ block: "nearest" });
    });
    if (index >= 0) input.setAttribute("aria-activedescendant", `search-option-${index}`);
  }

  /** `enter`: go to what is found if it is one thing. */
  async function run(enter: boolean): Promise<void> {
    const text = input.value.trim();
    const mine = ++asked;
    if (!text) return;
    try {
      const found = await actions.search(text);
      if (mine !== asked) return;
      options = optionsOf(found);
      if (enter && options.length === 1 && options[0]) return choose(options[0]);
      show(text, found.truncated);
    } catch (error) {
      if (mine !== asked) return;
      options = [];
      fill(list);
      say(messageOf(error), true);
    }
  }

  function show(text: string, truncated: boolean): void {
    const groups = [...new Set(options.map((o) => o.group))];
    fill(list, ...groups.map((group, g) => el("div", { role: "group", aria: { labelledby: `search-group-${g}` } },
      el("div", { class: "search-group", id: `search-group-${g}`, textContent: group, role: "presentation" }),
      ...options.flatMap((option, i) => (option.group === group ? [row(option, i)] : []))))); // prettier-ignore
    list.hidden = !options.length;
    input.setAttribute("aria-expanded", String(options.length > 0));
    say(options.length ? (truncated ? "There are more results: type more characters." : "") : `Nothing found for “${text}”. Try the first characters of a cone's id, a drive, a date (2026-03-02), a town or coordinates (easting northing, or latitude, longitude).`);
    activate(options.length ? 0 : -1);
  }

  function row(option: Option, index: number): HTMLElement {
    const node = el("div", { class: "search-option", role: "option", id: `search-option-${index}`, aria: { selected: "false" } },
      el("span", { textContent: option.text }), el("small", { textContent: option.detail })); // prettier-ignore
    node.addEventListener("pointerdown", (event) => event.preventDefault()); // the field keeps the focus
    node.addEventListener("click", () => choose(option));
    return node;
  }

  const optionsOf = (found: Found): Option[] => [
    ...found.feature_ids.map((id) => ({ group: "Cones", text: shortId(id), detail: id, run: () => actions.select(id) })),
    ...found.drives.map((d) => ({ group: d.kind === "drive" ? "Drives" : "Imported maps", text: d.drive_id, detail: `${utc(d.captured_from)} UTC`, run: () => actions.showChangeset(d.changeset_no) })),
    ...found.towns.map((p) => ({ group: "Towns", text: p.label, detail: coordinates(p), run: () => actions.flyTo(p) })),
    ...found.positions.map((p) => ({ group: "Coordinates", text: coordinates(p), detail: p.label, run: () => actions.flyTo(p) })),
  ]; // prettier-ignore

  return {
    focus(): void {
      input.focus();
      input.select();
    },
  };
}

const coordinates = ({ lat_lon_deg: at }: FoundPosition): string => (at ? `${at[0].toFixed(6)}, ${at[1].toFixed(6)}` : "outside the map's CRS");

/** A pin at a found position. */
export function createMarker(stage: Stage, host: HTMLElement, remove: () => void) {
  let at: [number, number, number] | null = null;
  const pin = el("button", { type: "button", class: "found-pin", hidden: true, title: "Search result: click to remove the marker", aria: { label: "Remove the marker" }, onclick: remove });
  host.append(pin);
  stage.beforeDraw(() => {
    const pixel = at && stage.project(at);
    pin.hidden = !pixel;
    if (pixel) pin.style.transform = `translate(${pixel[0]}px, ${pixel[1]}px)`;
  });
  return (position: [number, number, number] | null) => {
    if (at === position || (at && position && at.every((v, i) => v === position[i]))) return;
    at = position;
    pin.hidden = !position;
    stage.draw();
  };
}
