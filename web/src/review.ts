// A review: a page of its own with the images of one item of a queue, the map around it, and the queue. Verdicts go to the server
// one after the other while the next item is shown; this browser remembers only what was skipped.
import { ApiError } from "./api";
import { label, writer } from "./decisions";
import { el, fill, messageOf, plural } from "./dom";
import type { Start, Subject, Viewer } from "./viewer";

export interface By {
  decided_by: string;
  reason: string;
}
export type Undo = (by: By, token: string) => Promise<unknown>;
/** What a key means, and what it writes. */
export interface Answer {
  key: string;
  verb: string;
  text: string;
  done: string;
  /** `undo`: null if it cannot be taken back; `changed`: other images may show it now. */
  write(by: By, token: string): Promise<{ undo: Undo | null; changed: boolean }>;
}
/** How an item is shown; `version` is another one when its images may be others. */
export interface Card {
  key: string;
  version: string;
  heading: string;
  question: string;
  name: string;
  isId: boolean;
  about: string;
  why: string;
  /** What a person said before: empty, nothing. */
  judged: string;
}
/** What is reviewed. */
export interface Queue<T> {
  /** In the address and in what this browser keeps. */
  id: string;
  name: string;
  title: string;
  /** Items from an index on, and the number of all. */
  read(map: string, offset: number): Promise<{ items: T[]; total: number }>;
  card(item: T): Card;
  answers(item: T): Answer[];
  /** Further ones, by their number. */
  classes(item: T): Answer[];
  /** Why nobody may judge it here; null: one may. */
  refuses(item: T): string | null;
  show(item: T): void;
  subject(item: T): Promise<[Subject, Start | null]>;
  /** Without a note. */
  reason: string;
  /** What was written shows on the map. */
  decided(): void;
}
export interface ReviewActions {
  map(): string;
  writable(): boolean;
  /** The review covers the page, or no longer does. */
  opened(on: boolean): void;
  said(text: string): void;
}
interface Verdict {
  text: string;
  state: "saving" | "saved" | "failed" | "withdrawing";
  /** Why it was not written. */
  problem: string;
  undo: Undo | null;
}

/** More than a person reviews in a day; the badge then says so. */
const MOST = 500;
/** Items whose images are read before they are shown. */
const AHEAD = 2;
/** Beside the drive before, where there is one. */
const COMPARED = true;

export function createReview<T>(app: HTMLElement, viewer: Viewer, actions: ReviewActions, of: Queue<T>) {
  const keyOf = (item: T) => of.card(item).key;
  const badge = el("b", { class: "badge", textContent: "…", data: { count: "" } });
  const button = el("button", { type: "button", class: "link review-button", title: of.title, data: { queue: of.id }, onclick: () => set(true) }, el("span", { textContent: `${of.name} ` }), badge);
  const question = el("h2", { tabIndex: -1 });
  const progress = el("span", { class: "review-progress", role: "status", aria: { live: "polite" } });
  const why = el("p", { class: "why", tabIndex: 0 }); // it scrolls on small screens
  const images = el("div", { class: "review-images" });
  const list = el("ol", { class: "review-items", aria: { label: "Items to review" } });
  const buttons = el("div", { class: "review-buttons" });
  const note = el("input", { type: "text", class: "review-note", maxLength: 500, autocomplete: "off", placeholder: "Note for the next verdict (N)", aria: { label: "Note for the next verdict" } });
  const foot = el("footer", { class: "review-actions" }, buttons, note);
  const page = el("section", { class: "review", hidden: true, aria: { label: of.name } },
    el("header", { class: "review-head" }, question, progress, el("span", { class: "space" }), keyButton("Leave", "", "Esc", () => set(false)), why),
    images, list, foot); // prettier-ignore

  let items: T[] = [];
  /** null until the server has said it. */
  let total: number | null = null;
  let map = "";
  let current: string | null = null;
  let failed = "";
  let loadNo = 0;
  let choosingClass = false;
  /** Typed once before the first verdict, and again if the server refuses it. */
  let asking: HTMLFormElement | null = null;
  let shownKey = "";
  const verdicts = new Map<string, Verdict>();
  const subjects = new Map<string, Promise<[Subject, Start | null]>>();
  let queue = Promise.resolve();
  let writing = 0;

  function keyButton(text: string, meaning: string, key: string, run: () => void): HTMLButtonElement {
    return el("button", { type: "button", onclick: run, title: key === "Esc" ? "Back to the map (Esc)" : "" }, el("b", { textContent: text }), Boolean(meaning) && el("span", { textContent: ` ${meaning}` }), " ", el("kbd", { textContent: key }));
  }

  const store = () => `conetl ${of.id} ${actions.map()}`;
  const skipped = (): Set<string> => {
    try {
      return new Set(JSON.parse(localStorage.getItem(store()) ?? "[]") as string[]);
    } catch {
      return new Set();
    }
  };
  const isOpen = (aside: Set<string>) => (i: T) => !aside.has(keyOf(i)) && !of.card(i).judged && (verdicts.get(keyOf(i))?.state ?? "failed") === "failed";
  const chosen = () => items.find((i) => keyOf(i) === current);

  async function load(): Promise<void> {
    const mine = ++loadNo;
    if (map !== actions.map()) {
      [map, items, total, current] = [actions.map(), [], null, null];
      verdicts.clear();
      subjects.clear();
      draw();
    }
    const found: T[] = [];
    // What is saved while this is read may be missing in it.
    const saved = new Set([...verdicts].flatMap(([key, verdict]) => (verdict.state === "saved" ? key : [])));
    try {
      do {
        const part = await of.read(actions.map(), found.length);
        if (mine !== loadNo) return;
        total = part.total;
        found.push(...part.items);
        if (!part.items.length) break;
      } while (found.length < Math.min(total, MOST));
      keep(found, saved);
      failed = "";
    } catch (error) {
      if (mine !== loadNo) return;
      failed = messageOf(error);
    }
    if (!chosen()) current = null;
    draw();
    if (!page.hidden) choose(chosen() ?? following()); // its version may be another one
  }

  /** Items keep their place while the review is open, and those judged here stay in the list. */
  function keep(found: T[], saved: Set<string>): void {
    const now = new Map(found.map((i) => [keyOf(i), i]));
    for (const [key, verdict] of verdicts) {
      if (verdict.state !== "failed" || now.has(key)) continue;
      verdicts.delete(key);
      actions.said(`“${verdict.text}” was not saved, and this item does not need a verdict any more. ${verdict.problem}`);
    }
    const kept = page.hidden ? [] : items.flatMap((i) => now.get(keyOf(i)) ?? (verdicts.has(keyOf(i)) ? i : []));
    const known = new Set(kept.map(keyOf));
    for (const [key, verdict] of verdicts) if (verdict.state === "saved" && saved.has(key) && now.has(key) && !writing) verdicts.delete(key); // withdrawn elsewhere
    items = [...kept, ...found.filter((i) => !known.has(keyOf(i)))];
  }

  /** The next open items after the current one, then those before it. */
  function coming(): T[] {
    const at = items.findIndex((i) => keyOf(i) === current);
    return [...items.slice(at + 1), ...items.slice(0, Math.max(at, 0))].filter(isOpen(skipped())).slice(0, AHEAD);
  }
  const following = (): T | undefined => coming()[0];

  function set(on: boolean): void {
    if (on === !page.hidden) return;
    page.hidden = !on;
    on ? app.append(page) : page.remove();
    app.classList.toggle("reviewing", on);
    asking = null;
    if (on) viewer.dockIn(images);
    actions.opened(on);
    if (on) {
      question.focus();
      choose(chosen() ?? items.find(isOpen(skipped())) ?? items[0]);
    } else {
      items = items.filter((i) => verdicts.get(keyOf(i))?.state !== "saved");
      shownKey = "";
      draw();
      button.focus();
    }
  }

  function choose(item: T | undefined): void {
    if (item) current = keyOf(item);
    choosingClass = false;
    draw();
    list.querySelector<HTMLElement>('[aria-current="true"]')?.scrollIntoView({ block: "nearest" });
    if (item && shownKey !== versionOf(item)) {
      shownKey = versionOf(item);
      of.show(item);
      void showImages(item);
    }
  }

  const versionOf = (item: T) => `${keyOf(item)} ${of.card(item).version}`;
  const subjectOf = (item: T) => {
    const key = versionOf(item);
    const found = subjects.get(key) ?? of.subject(item);
    subjects.set(key, found);
    found.catch(() => subjects.delete(key));
    return found;
  };

  async function showImages(item: T): Promise<void> {
    try {
      const [subject, start] = await subjectOf(item);
      if (keyOf(item) !== current || page.hidden) return;
      const shown = viewer.show(subject, start, COMPARED);
      draw();
      await shown;
      for (const next of coming()) if (keyOf(item) === current) await viewer.preload(...(await subjectOf(next)), COMPARED);
    } catch (error) {
      if (keyOf(item) === current) why.textContent = messageOf(error);
    }
  }

  // --- drawing

  function draw(): void {
    const aside = skipped();
    const open = items.filter(isOpen(aside)).length;
    const count = total === null ? null : open + Math.max(total - items.length, 0);
    badge.textContent = count === null ? (failed ? "?" : "…") : count.toLocaleString("en");
    badge.dataset["count"] = String(count ?? "");
    button.setAttribute("aria-label", `${of.name}: ${count === null ? "number of items unknown" : plural(count, "item")}`);
    if (page.hidden) return;
    const rows = items.flatMap((item, i) => {
      const card = of.card(item);
      const verdict = verdicts.get(card.key);
      const state = verdict ? { saving: `${verdict.text}, saving …`, saved: `${verdict.text} ✓`, failed: "not saved", withdrawing: "withdrawing …" }[verdict.state] : aside.has(card.key) ? "skipped" : card.judged && `${card.judged} ✓`;
      const row = el("li", { class: verdict?.state ?? "", data: { item: card.name } }, el("button", { type: "button", onclick: () => choose(item) },
        el("b", { class: card.isId ? "mono" : "", textContent: card.name }), el("i", { textContent: state }), el("small", { textContent: card.about }))); // prettier-ignore
      row.setAttribute("aria-current", String(card.key === current));
      const before = items[i - 1];
      return before && of.card(before).heading === card.heading ? [row] : [el("li", { class: "heading" }, el("h3", { textContent: card.heading })), row];
    });
    fill(list, ...rows, Boolean(failed) && el("li", { class: "hint bad", textContent: failed }));
    const at = items.findIndex((i) => keyOf(i) === current);
    fill(progress, at >= 0 && `${(at + 1).toLocaleString("en")} of ${items.length.toLocaleString("en")}`, count !== null && el("span", { textContent: ` · ${count.toLocaleString("en")} left` }), writing > 0 && ` · saving ${writing} …`);
    drawItem();
  }

  function drawItem(): void {
    const item = chosen();
    images.hidden = note.hidden = !item;
    if (!item) {
      question.textContent = total === null ? "Loading …" : "Nothing to review";
      why.textContent = failed;
      return fill(buttons, keyButton("Leave", "", "Esc", () => set(false)));
    }
    const card = of.card(item);
    const verdict = verdicts.get(card.key);
    question.textContent = card.question;
    why.textContent = card.why;
    note.hidden = !actions.writable() || asking !== null;
    if (asking?.isConnected) return; // somebody is typing
    const focused = buttons.contains(document.activeElement);
    const refusal = actions.writable() ? of.refuses(item) : writer.person() === null ? "Read-only: decisions require `conetl view --decisions`." : "Read-only: decisions require the role review, and `conetl view --decisions`.";
    fill(buttons, ...(asking ? [asking] : refusal !== null ? [el("p", { class: "hint", textContent: refusal }), ...moves()] : choosingClass ? classButtons(item) : verdict && verdict.state !== "failed" ? judged(verdict, item) : answers(item, verdict)));
    if (focused && !asking) buttons.querySelector<HTMLElement>("button")?.focus();
  }

  const moves = () => [keyButton("Skip", "", "S", skip), keyButton("Back", "", "B", () => go(-1))];

  const answers = (item: T, verdict: Verdict | undefined) => [
    ...(verdict ? [el("p", { class: "hint bad", role: "alert", textContent: `“${verdict.text}” was not saved. ${verdict.problem}` })] : []),
    ...of.answers(item).map((answer) => keyButton(answer.verb, answer.text, answer.key, () => judge(item, answer))),
    ...(of.classes(item).length ? [keyButton("Class …", "", "C", () => chooseClass(true))] : []),
    ...moves(),
  ];

  const judged = (verdict: Verdict, item: T) => [
    el("p", { class: "hint", textContent: verdict.state === "saved" ? `Judged: ${verdict.text}. Saved.` : `Judged: ${verdict.text}. Saving …` }),
    ...(verdict.state === "saved" && verdict.undo ? [keyButton("Withdraw", "", "W", () => withdraw(item))] : []),
    keyButton("Next", "", "S", () => choose(following())), keyButton("Back", "", "B", () => go(-1)),
  ]; // prettier-ignore

  const classButtons = (item: T) => [
    ...of.classes(item).map((answer) => keyButton(answer.verb, answer.text, answer.key, () => judge(item, answer))),
    keyButton("Cancel", "", "C", () => chooseClass(false)),
  ];

  function chooseClass(on: boolean): void {
    choosingClass = on;
    draw();
  }

  function form(problem: string, then: () => void): HTMLFormElement {
    const name = el("input", { type: "text", name: "name", required: true, minLength: 2, maxLength: 80, autocomplete: "name", placeholder: " ", value: writer.name() });
    const token = el("input", { type: "password", name: "token", required: true, autocomplete: "off", placeholder: " " });
    const made = el("form", { class: "review-writer" }, Boolean(problem) && el("p", { class: "hint bad", role: "alert", textContent: problem }),
      label("Your name", name, "Visible to everyone who sees the map."), label("Writer token", token, "In the file that conetl view names when it starts."),
      el("button", { type: "submit", class: "primary", textContent: "Continue" }), el("button", { type: "button", textContent: "Cancel", onclick: () => ask(null) })); // prettier-ignore
    made.addEventListener("submit", (event) => {
      event.preventDefault();
      writer.keep(name.value.trim(), token.value.trim());
      ask(null);
      then();
    });
    return made;
  }

  function ask(what: HTMLFormElement | null): void {
    asking?.remove();
    asking = what;
    draw();
    if (what) what.querySelector<HTMLInputElement>("input:placeholder-shown")?.focus(); // the first empty one
    else question.focus();
  }

  // --- verdicts

  /** With the note, which is for one verdict. */
  function signed(reason: string): By {
    const typed = note.value.trim();
    note.value = "";
    return { decided_by: writer.name(), reason: typed.length > 2 ? typed : reason };
  }

  function judge(item: T, answer: Answer): void {
    const token = writer.token();
    if (token === null) return ask(form("", () => judge(item, answer)));
    const by = signed(of.reason);
    const verdict: Verdict = { text: answer.done, state: "saving", problem: "", undo: null };
    verdicts.set(keyOf(item), verdict);
    save(async () => {
      try {
        const { undo, changed } = await answer.write(by, writer.token() ?? token);
        verdict.undo = undo;
        if (changed) subjects.clear();
        verdict.state = "saved";
      } catch (error) {
        Object.assign(verdict, { state: "failed", problem: messageOf(error) });
        if (!(error instanceof ApiError) || error.status !== 401) return;
        writer.forget();
        verdicts.delete(keyOf(item));
        choose(item);
        ask(form(verdict.problem, () => judge(item, answer)));
      }
    });
    choose(following() ?? item);
  }

  function withdraw(item: T): void {
    const verdict = verdicts.get(keyOf(item));
    if (!verdict?.undo || verdict.state !== "saved") return;
    const { undo } = verdict;
    const by = signed("withdrawn in the review");
    verdict.state = "withdrawing";
    save(async () => {
      try {
        await undo(by, writer.token() ?? "");
        verdicts.delete(keyOf(item));
        subjects.clear();
        if (total !== null) total += 1;
      } catch (error) {
        verdict.state = "saved";
        verdict.text += ` (not withdrawn: ${messageOf(error)})`;
      }
    });
    draw();
  }

  /** One after the other: each locks the map. What they changed is read when the last one is written. */
  function save(write: () => Promise<void>): void {
    writing += 1;
    queue = queue.then(write).then(() => {
      writing -= 1;
      draw();
      if (!writing) of.decided();
    });
  }

  function skip(): void {
    const item = chosen();
    if (!item) return;
    const next = following();
    if (!verdicts.has(keyOf(item))) localStorage.setItem(store(), JSON.stringify([...skipped(), keyOf(item)].slice(-5000)));
    choose(next ?? item);
  }

  function go(by: number): void {
    choose(items[items.findIndex((i) => keyOf(i) === current) + by] ?? chosen());
  }

  function press(key: string): boolean {
    const wanted = [...page.querySelectorAll<HTMLButtonElement>(".review-buttons button, .review-head button")].find((b) => b.querySelector("kbd")?.textContent?.toLowerCase() === key);
    wanted?.click();
    return wanted !== undefined;
  }

  return {
    id: of.id,
    button,
    load: () => void load(),
    set,
    get isOpen() {
      return !page.hidden;
    },
    /** Keys while the review covers the page: whether this one meant something. */
    key(event: KeyboardEvent, typing: boolean): boolean {
      const key = event.key.toLowerCase();
      if (typing) {
        if (key === "escape") asking ? ask(null) : note.blur();
        return key === "escape" || (key === "enter" && event.target === note && (note.blur(), true));
      }
      if (key === "escape") return choosingClass ? chooseClass(false) : set(false), true;
      if (key === "n" && !note.hidden) return note.focus(), true;
      if (key === "arrowdown" || key === "arrowup") return go(key === "arrowdown" ? 1 : -1), true;
      if ((key === " " || key === "enter") && event.target instanceof HTMLButtonElement) return false;
      return press(key) || (!"bc".includes(key) && viewer.key(event));
    },
  };
}
