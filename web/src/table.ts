// A table of any number of rows: only the visible ones are in the document, and those are recycled while it scrolls.
import { el, fill } from "./dom";

export interface Column<T> {
  id: string;
  title: string;
  /** Explanation of the title. */
  hint?: string;
  width: string;
  /** Right-aligned, in digits of equal width. */
  number?: boolean;
  /** What it sorts by; null comes last in both directions. */
  value(row: T): number | string | null;
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
  show(rows: T[], sort: Sort, columns: Column<T>[]): void;
  /** Highlight a row; with `scroll` it is scrolled into view. */
  choose(id: string | null, scroll: boolean): void;
}

export interface TableOptions<T> {
  label: string;
  id(row: T): string;
  sort(sort: Sort): void;
  /** A row was clicked, or reached by key. */
  chosen(row: T): void;
}

const ROW_PX = 26;
/** Rows above and below the visible ones, so that fast scrolling shows no gaps. */
const SPARE = 3;
/** A held key goes on to the next rows without asking the server for each. */
const REST_MS = 140;
let tables = 0;

export function createTable<T>(options: TableOptions<T>): Table<T> {
  const name = `table-${++tables}`;
  let columns: Column<T>[] = [];
  let heads: HTMLElement[] = [];
  let rows: T[] = [];
  let sorted: Sort = "";
  let chosenId: string | null = null;
  let slots: Slot<T>[] = [];
  let pending = false;
  let timer = 0;

  const headRow = el("div", { class: "row", role: "row", aria: { rowindex: "1" } });
  const space = el("div", { class: "table-space", role: "rowgroup" });
  const none = el("p", { class: "table-none hint", hidden: true });
  const node = el("div", { class: "table", role: "grid", tabIndex: 0, aria: { label: options.label } },
    el("div", { class: "table-head", role: "rowgroup" }, headRow), space); // prettier-ignore
  const wrap = el("div", { class: "table-wrap" }, node, none);

  const first = () => Math.max(0, Math.floor(node.scrollTop / ROW_PX) - SPARE);
  const indexOf = (id: string | null) => (id === null ? -1 : rows.findIndex((row) => options.id(row) === id));

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
    const count = Math.min(rows.length, Math.ceil(node.clientHeight / ROW_PX) + 2 * SPARE);
    while (slots.length < count) {
      const slot = makeSlot(columns, name, slots.length);
      slots.push(slot);
      space.append(slot.node);
    }
    for (const slot of slots.splice(count)) slot.node.remove();
    const from = Math.max(0, Math.min(first(), rows.length - count));
    for (let i = from; i < from + count; i++) {
      const slot = slots[i % count];
      const row = rows[i];
      if (slot && row !== undefined) slot.set(row, i, options.id(row) === chosenId);
    }
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
    const top = index * ROW_PX;
    const height = node.clientHeight - ROW_PX; // without the header
    if (top < node.scrollTop) node.scrollTop = top;
    else if (top + ROW_PX > node.scrollTop + height) node.scrollTop = top + ROW_PX - height;
  }

  node.addEventListener("scroll", drawSoon, { passive: true });
  new ResizeObserver(drawSoon).observe(node);
  space.addEventListener("click", (event) => {
    const clicked = event.target instanceof Element ? event.target.closest<HTMLElement>("[data-index]") : null;
    const row = rows[Number(clicked?.dataset["index"])];
    if (row === undefined) return;
    chosenId = options.id(row);
    draw();
    options.chosen(row);
  });
  node.addEventListener("keydown", (event) => {
    if (event.target !== node || event.ctrlKey || event.metaKey || event.altKey || !rows.length) return;
    const page = Math.max(1, Math.floor(node.clientHeight / ROW_PX) - 2);
    const steps: Record<string, number> = { ArrowDown: 1, ArrowUp: -1, PageDown: page, PageUp: -page, Home: -rows.length, End: rows.length };
    const at = indexOf(chosenId);
    const by = steps[event.key];
    if (by === undefined && event.key !== "Enter") return;
    event.preventDefault();
    event.stopPropagation();
    const next = Math.max(0, Math.min(rows.length - 1, (at < 0 && by === 1 ? -1 : at) + (by ?? 0)));
    const row = rows[next];
    if (row === undefined) return;
    chosenId = options.id(row);
    reveal(next);
    draw();
    window.clearTimeout(timer);
    timer = window.setTimeout(() => options.chosen(row), REST_MS);
  });

  return {
    node: wrap,
    show(next, sort, shown) {
      if (shown !== columns) setColumns(shown);
      rows = next;
      sorted = sort;
      space.style.height = `${rows.length * ROW_PX}px`;
      node.setAttribute("aria-rowcount", String(rows.length + 1));
      none.hidden = rows.length > 0;
      columns.forEach((column, i) => {
        const direction = sort === column.id ? "ascending" : sort === `${column.id}-` ? "descending" : "none";
        heads[i]?.setAttribute("aria-sort", direction);
      });
      for (const slot of slots) slot.forget();
      draw();
      fill(none, "Nothing matches the filters, or nothing changed.");
    },
    choose(id, scroll) {
      chosenId = id;
      const index = scroll ? indexOf(id) : -1;
      if (index >= 0) reveal(index);
      draw();
    },
  };
}

function nextSort<T>(column: Column<T>, now: Sort): Sort {
  if (now === column.id) return `${column.id}-`;
  if (now === `${column.id}-`) return column.id;
  return column.descending ? `${column.id}-` : column.id;
}

/** A copy in the order of a column. Equal rows keep their order. */
export function inOrder<T>(rows: T[], columns: Column<T>[], sort: Sort): T[] {
  const sign = sort.endsWith("-") ? -1 : 1;
  const column = columns.find((c) => c.id === sort.replace(/-$/, ""));
  if (!column) return rows;
  const keys = rows.map((row) => column.value(row));
  const order = rows.map((_, i) => i).sort((a, b) => {
    const [x, y] = [keys[a] ?? null, keys[b] ?? null];
    if (x === null || y === null) return x === y ? a - b : x === null ? 1 : -1;
    return x < y ? -sign : x > y ? sign : a - b;
  });
  return order.map((i) => rows[i] as T);
}

interface Slot<T> {
  node: HTMLElement;
  readonly chosen: boolean;
  set(row: T, index: number, isChosen: boolean): void;
  forget(): void;
}

function makeSlot<T>(columns: Column<T>[], name: string, number: number): Slot<T> {
  const cells = columns.map((column) => el("div", { class: column.number ? "cell number" : "cell", role: "gridcell" }));
  const node = el("div", { class: "row", role: "row", id: `${name}-${number}` }, ...cells);
  let [shown, at, isChosen]: [T | null, number, boolean] = [null, -1, false];
  return {
    node,
    get chosen() {
      return isChosen;
    },
    forget: () => void (shown = null),
    set(row, index, choose) {
      if (index !== at) {
        at = index;
        node.style.transform = `translateY(${index * ROW_PX}px)`;
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
        if (column.icon) fill(cell, column.icon(row), column.text(row));
        else cell.textContent = column.text(row);
        if (column.whole) cell.title = column.whole(row);
      });
    },
  };
}
