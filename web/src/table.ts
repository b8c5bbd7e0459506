// A table of any number of rows: only the visible ones are in the document, and those are recycled while it scrolls. Rows that are not
// there yet are empty.
import { el, fill } from "./dom";

export interface Column<T> {
  id: string;
  title: string;
  /** Explanation of the title. */
  hint?: string;
  width: string;
  /** Right-aligned, in digits of equal width. */
  number?: boolean;
  text(row: T): string;
  icon?(row: T): Node;
  /** Shown when the mouse rests on the cell. */
  whole?(row: T): string;
  /** Direction of the first click. */
  descending?: boolean;
}

/** Id of a column, with "-" at the end if descending. */
export type Sort = string;

export interface Table<T> {
  node: HTMLElement;
  /** `none`: shown instead of no rows. */
  show(count: number, sort: Sort, columns: Column<T>[], none: string): void;
  /** Highlight the row of this index; with `scroll` it is scrolled into view. */
  choose(index: number | null, scroll: boolean): void;
  /** Rows have arrived. */
  draw(): void;
}

export interface TableOptions<T> {
  label: string;
  /** Undefined: not there yet. */
  row(index: number): T | undefined;
  /** These rows are visible. */
  wanted(from: number, to: number): void;
  sort(sort: Sort): void;
  /** A row was clicked, or reached by key. */
  chosen(index: number): void;
}

const ROW_PX = 26;
/** Browsers draw no higher elements: the scroll bar of more rows is a scale. */
const MOST_PX = 16_000_000;
/** Rows above and below the visible ones, so that fast scrolling shows no gaps. */
const SPARE = 3;
/** A held key goes on to the next rows without asking the server for each. */
const REST_MS = 140;
let tables = 0;

export function createTable<T>(options: TableOptions<T>): Table<T> {
  const name = `table-${++tables}`;
  let columns: Column<T>[] = [];
  let heads: HTMLElement[] = [];
  let total = 0;
  let sorted: Sort = "";
  let chosen: number | null = null;
  let slots: Slot<T>[] = [];
  let pending = false;
  let timer = 0;

  const headRow = el("div", { class: "row", role: "row", aria: { rowindex: "1" } });
  const space = el("div", { class: "table-space", role: "rowgroup" });
  const none = el("p", { class: "table-none hint", hidden: true });
  const node = el("div", { class: "table", role: "grid", tabIndex: 0, aria: { label: options.label } },
    el("div", { class: "table-head", role: "rowgroup" }, headRow), space); // prettier-ignore
  const wrap = el("div", { class: "table-wrap" }, node, none);

  /** Pixels of rows above the visible ones, and how much more of them there are than of the scroll bar. */
  const room = () => Math.max(node.clientHeight - ROW_PX, 1);
  const scale = () => (total * ROW_PX <= MOST_PX ? 1 : (total * ROW_PX - room()) / (MOST_PX - room()));
  const top = () => node.scrollTop * scale();

  function setColumns(next: Column<T>[]): void {
    columns = next;
    heads = columns.map((column) => {
      const button = el("button", { type: "button", textContent: column.title, title: column.hint ?? "", onclick: () => options.sort(nextSort(column, sorted)) });
      return el("div", { class: column.number ? "cell number" : "cell", role: "columnheader" }, button);
    });
    fill(headRow, ...heads);
    node.setAttribute("aria-colcount", String(columns.length));
    node.style.setProperty("--columns", columns.map((c) => c.width).join(" "));
    // Header and rows are grids of their own: of the same width, they have the same columns.
    node.style.setProperty("--least", `calc(20px + ${columns.map((c) => /\d+px/.exec(c.width)?.[0] ?? "0px").join(" + ")})`);
    for (const slot of slots.splice(0)) slot.node.remove();
  }

  function draw(): void {
    const count = Math.min(total, Math.ceil(node.clientHeight / ROW_PX) + 2 * SPARE);
    while (slots.length < count) {
      const slot = makeSlot(columns, name, slots.length);
      slots.push(slot);
      space.append(slot.node);
    }
    for (const slot of slots.splice(count)) slot.node.remove();
    const first = Math.max(0, Math.floor(top() / ROW_PX) - SPARE);
    const from = Math.max(0, Math.min(first, total - count));
    for (let i = from; i < from + count; i++) slots[i % count]?.set(options.row(i), i, i * ROW_PX - top() + node.scrollTop, i === chosen);
    if (count) options.wanted(from, from + count);
    const active = slots.find((slot) => slot.chosen);
    if (active) node.setAttribute("aria-activedescendant", active.node.id);
    else node.removeAttribute("aria-activedescendant");
  }

  function drawSoon(): void {
    if (pending) return;
    pending = true;
    requestAnimationFrame(() => {
      pending = false;
      draw();
    });
  }

  function reveal(index: number): void {
    const at = index * ROW_PX;
    if (at < top()) node.scrollTop = at / scale();
    else if (at + ROW_PX > top() + room()) node.scrollTop = (at + ROW_PX - room()) / scale();
  }

  node.addEventListener("scroll", drawSoon, { passive: true });
  new ResizeObserver(drawSoon).observe(node);
  space.addEventListener("click", (event) => {
    const clicked = event.target instanceof Element ? event.target.closest<HTMLElement>("[data-index]") : null;
    if (!clicked) return;
    chosen = Number(clicked.dataset["index"]);
    draw();
    options.chosen(chosen);
  });
  node.addEventListener("keydown", (event) => {
    if (event.target !== node || event.ctrlKey || event.metaKey || event.altKey || !total) return;
    const page = Math.max(1, Math.floor(node.clientHeight / ROW_PX) - 2);
    const steps: Record<string, number> = { ArrowDown: 1, ArrowUp: -1, PageDown: page, PageUp: -page, Home: -total, End: total };
    const by = steps[event.key];
    if (by === undefined && event.key !== "Enter") return;
    event.preventDefault();
    event.stopPropagation();
    const next = Math.max(0, Math.min(total - 1, chosen === null ? (by === 1 ? 0 : by ?? 0) : chosen + (by ?? 0)));
    chosen = next;
    reveal(next);
    draw();
    window.clearTimeout(timer);
    timer = window.setTimeout(() => options.chosen(next), REST_MS);
  });

  return {
    node: wrap,
    show(count, sort, shown, noneText) {
      if (shown !== columns) setColumns(shown);
      total = count;
      sorted = sort;
      space.style.height = `${Math.min(total * ROW_PX, MOST_PX)}px`;
      node.setAttribute("aria-rowcount", String(total + 1));
      none.hidden = total > 0;
      none.textContent = noneText;
      columns.forEach((column, i) => {
        const direction = sort === column.id ? "ascending" : sort === `${column.id}-` ? "descending" : "none";
        heads[i]?.setAttribute("aria-sort", direction);
      });
      for (const slot of slots) slot.forget();
      draw();
    },
    choose(index, scroll) {
      chosen = index;
      if (index !== null && scroll) reveal(index);
      draw();
    },
    draw,
  };
}

function nextSort<T>(column: Column<T>, now: Sort): Sort {
  if (now === column.id) return `${column.id}-`;
  if (now === `${column.id}-`) return column.id;
  return column.descending ? `${column.id}-` : column.id;
}

interface Slot<T> {
  node: HTMLElement;
  readonly chosen: boolean;
  set(row: T | undefined, index: number, y_px: number, isChosen: boolean): void;
  forget(): void;
}

function makeSlot<T>(columns: Column<T>[], name: string, number: number): Slot<T> {
  const cells = columns.map((column) => el("div", { class: column.number ? "cell number" : "cell", role: "gridcell" }));
  const node = el("div", { class: "row", role: "row", id: `${name}-${number}` }, ...cells);
  let [shown, at, y, isChosen]: [T | undefined | null, number, number, boolean] = [null, -1, -1, false];
  return {
    node,
    get chosen() {
      return isChosen;
    },
    forget: () => void (shown = null),
    set(row, index, y_px, choose) {
      if (y_px !== y) node.style.transform = `translateY(${(y = y_px)}px)`;
      if (index !== at) {
        at = index;
        node.dataset["index"] = String(index);
        node.setAttribute("aria-rowindex", String(index + 2));
        node.classList.toggle("odd", index % 2 === 1);
      }
      if (choose !== isChosen || shown === null) {
        isChosen = choose;
        node.setAttribute("aria-selected", String(choose));
      }
      if (row === shown) return;
      shown = row;
      columns.forEach((column, i) => {
        const cell = cells[i];
        if (!cell) return;
        if (row === undefined) cell.textContent = "";
        else if (column.icon) fill(cell, column.icon(row), column.text(row));
        else cell.textContent = column.text(row);
        if (column.whole) cell.title = row === undefined ? "" : column.whole(row);
      });
    },
  };
}
