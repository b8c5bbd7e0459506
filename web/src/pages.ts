// Rows of a list on the server: the pages that were looked at, and the ones that are asked for while one scrolls.

export interface Page<T> {
  rows: T[];
  /** Where the next page begins; null: this is the last one. */
  next: string | null;
}
/** From a number of rows on; `after` is the `next` of the page before, where it is known: then the server need not count rows. */
export type AskPage<T> = (offset: number, after: string | null) => Promise<Page<T>>;

export const PAGE_ROWS = 100;
const MOST_PAGES = 60;
/** Pages that a fast scroll only passes are not asked for. */
const REST_MS = 60;

export function createPages<T>(arrived: () => void, failed: (error: unknown) => void) {
  let ask: AskPage<T> | null = null;
  let pages = new Map<number, Page<T>>();
  let asked = new Map<number, Promise<void>>();
  let timer = 0;

  function load(number: number): Promise<void> {
    const [of, into, requests] = [ask, pages, asked];
    if (!of || into.has(number)) return Promise.resolve();
    const going = requests.get(number);
    if (going) return going;
    const before = into.get(number - 1);
    const answer = of(number * PAGE_ROWS, before?.next ?? null).then((page) => {
      requests.delete(number);
      into.set(number, page);
      for (const old of [...into.keys()].slice(0, Math.max(into.size - MOST_PAGES, 0))) into.delete(old);
      if (into === pages) arrived();
    });
    requests.set(number, answer);
    return answer;
  }

  return {
    /** Another list, with its first page. */
    open(of: AskPage<T> | null, first: Page<T>): void {
      window.clearTimeout(timer);
      [ask, pages, asked] = [of, new Map([[0, first]]), new Map()];
    },
    row: (index: number): T | undefined => pages.get(Math.floor(index / PAGE_ROWS))?.rows[index % PAGE_ROWS],
    /** The index of a row among those that are there. */
    find(accept: (row: T) => boolean): number | null {
      for (const [number, { rows }] of pages) {
        const at = rows.findIndex(accept);
        if (at >= 0) return number * PAGE_ROWS + at;
      }
      return null;
    },
    /** These rows are in view: their pages are asked for once the scrolling rests. */
    want(from: number, to: number): void {
      window.clearTimeout(timer);
      const numbers = [Math.floor(from / PAGE_ROWS), Math.floor(Math.max(to - 1, from) / PAGE_ROWS)].filter((n) => !pages.has(n));
      if (numbers.length) timer = window.setTimeout(() => void Promise.all([...new Set(numbers)].map(load)).catch(failed), REST_MS);
    },
    async rowAt(index: number): Promise<T | undefined> {
      await load(Math.floor(index / PAGE_ROWS));
      return this.row(index);
    },
  };
}
export type Pages<T> = ReturnType<typeof createPages<T>>;
