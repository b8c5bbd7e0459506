// The review: a page of its own with the images of one item of the queue, the map around it, and the queue. Verdicts go to the server
// one after the other while the next item is shown; this browser remembers only what was skipped.
import { api, ApiError, type DecisionRequest } from "./api";
import { CLASSES, classOf } from "./classes";
import { label, writer } from "./decisions";
import { el, fill, messageOf, plural, shortId, utc } from "./dom";
import { judging, type ReviewItem, type ReviewKind } from "./judging";
import type { Start, Subject, Viewer } from "./viewer";

export interface ReviewActions {
  map(): string;
  writable(): boolean;
  decidesDrives(): boolean;
  /** The review covers the page, or no longer does. */
  opened(on: boolean): void;
  /** Show a cone after the drive that changed it, or a drive on hold, on the map. */
  show(item: ReviewItem): void;
  subject(item: ReviewItem): Promise<[Subject, Start | null]>;
  /** What was written shows on the map. */
  decided(): void;
  said(text: string): void;
}

interface By {
  decided_by: string;
  reason: string;
}
/** What a key means, and what it writes. */
interface Answer {
  text: string;
  done: string;
  request(item: ReviewItem, by: By): DecisionRequest;
}
interface Verdict {
  text: string;
  state: "saving" | "saved" | "failed" | "withdrawing";
  /** Why it was not written. */
  problem: string;
  decisionId: string | null;
}

const about = (i: ReviewItem) => ({ feature_id: i.feature_id ?? "", expected_version: i.version ?? 0 });
const place = (kind: "pin" | "suppress", text: string, done: string): Answer => ({ text, done, request: (i, by) => ({ kind, radius_m: 1, ...about(i), ...by }) });
const approve = (text: string, done: string): Answer => ({ text, done, request: (i, by) => ({ kind: "approve", ...about(i), ...by }) });
const drive = (kind: "accept" | "revert", text: string, done: string): Answer => ({ text, done, request: (i, by) => ({ kind, changeset_id: i.changeset_id ?? "", ...by }) });
const ofClass = (category: string): Answer => {
  const text = classOf(category).label;
  return { text, done: text.toLowerCase(), request: (i, by) => ({ kind: "classify", category, ...about(i), ...by }) };
};
const KINDS: Record<ReviewKind, { heading: string; question: string; accept: Answer; reject: Answer }> = {
  held: { heading: "Drives on hold", question: "May this drive change the map?", accept: drive("accept", "it may", "accepted"), reject: drive("revert", "leave it out", "left out") },
  removal: { heading: "Removed cones", question: "Is this cone gone?", accept: approve("it is gone", "gone"), reject: place("pin", "it still stands", "still stands") },
  move: { heading: "Moved by 1 m or more", question: "Does the cone stand here now?", accept: approve("it stands here", "moved"), reject: place("suppress", "no cone here", "no cone") },
  doubtful: { heading: "Uncertain cones", question: "Does a cone stand here?", accept: place("pin", "it stands", "stands"), reject: place("suppress", "no cone here", "no cone") },
};
const REASON = "judged in the images";
const PAGE = 100;
/** More than a person reviews in a day; the badge then says so. */
const MOST = 500;
/** Items whose images are read before they are shown. */
const AHEAD = 2;
/** Beside the drive before, where there is one. */
const COMPARED = true;

const keyOf = (i: ReviewItem) => `${i.kind} ${i.feature_id ?? i.changeset_id ?? ""} ${i.changeset_no}`;

export function createReview(app: HTMLElement, viewer: Viewer, actions: ReviewActions) {
  const badge = el("b", { class: "badge", textContent: "…", data: { count: "" } });
  const button = el("button", { type: "button", class: "link review-button", title: "Drives and changes to review, in images", onclick: () => set(true) }, el("span", { textContent: "Review " }), badge);
  const question = el("h2", { tabIndex: -1 });
  const progress = el("span", { class: "review-progress", role: "status", aria: { live: "polite" } });
  const why = el("p", { class: "why" });
  const images = el("div", { class: "review-images" });
  const list = el("ol", { class: "review-items", aria: { label: "Items to review" } });
  const buttons = el("div", { class: "review-buttons" });
  const note = el("input", { type: "text", class: "review-note", maxLength: 500, autocomplete: "off", placeholder: "Note for the next verdict (N)", aria: { label: "Note for the next verdict" } });
  const foot = el("footer", { class: "review-actions" }, buttons, note);
  const page = el("section", { class: "review", hidden: true, aria: { label: "Review" } },
    el("header", { class: "review-head" }, question, progress, el("span", { class: "space" }), keyButton("Leave", "", "Esc", () => set(false)), why),
    images, list, foot); // prettier-ignore
  app.append(page);

  let items: ReviewItem[] = [];
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

  const store = () => `conetl review ${actions.map()}`;
  const skipped = (): Set<string> => {
    try {
      return new Set(JSON.parse(localStorage.getItem(store()) ?? "[]") as string[]);
    } catch {
      return new Set();
    }
  };
  const isOpen = (aside: Set<string>) => (i: ReviewItem) => !aside.has(keyOf(i)) && (verdicts.get(keyOf(i))?.state ?? "failed") === "failed";
  const chosen = () => items.find((i) => keyOf(i) === current);

  async function load(): Promise<void> {
    const mine = ++loadNo;
    if (map !== actions.map()) {
      [map, items, total, current] = [actions.map(), [], null, null];
      verdicts.clear();
      subjects.clear();
      draw();
    }
    const found: ReviewItem[] = [];
    try {
      do {
        const part = await judging.review(actions.map(), found.length, PAGE);
        if (mine !== loadNo) return;
        total = Object.values(part.counts).reduce((a, b) => a + b, 0);
        found.push(...part.items);
        if (!part.items.length) break;
      } while (found.length < Math.min(total, MOST));
      keep(found);
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
  function keep(found: ReviewItem[]): void {
    const now = new Map(found.map((i) => [keyOf(i), i]));
    for (const [key, verdict] of verdicts) {
      if (verdict.state !== "failed" || now.has(key)) continue;
      verdicts.delete(key);
      actions.said(`“${verdict.text}” was not saved, and this item does not need a verdict any more. ${verdict.problem}`);
    }
    const kept = page.hidden ? [] : items.flatMap((i) => now.get(keyOf(i)) ?? (verdicts.has(keyOf(i)) ? i : []));
    const known = new Set(kept.map(keyOf));
    for (const [key, verdict] of verdicts) if (verdict.state === "saved" && now.has(key) && !writing) verdicts.delete(key); // withdrawn elsewhere
    items = [...kept, ...found.filter((i) => !known.has(keyOf(i)))];
  }

  /** The next open items after the current one, then those before it. */
  function coming(): ReviewItem[] {
    const at = items.findIndex((i) => keyOf(i) === current);
    return [...items.slice(at + 1), ...items.slice(0, Math.max(at, 0))].filter(isOpen(skipped())).slice(0, AHEAD);
  }
  const following = (): ReviewItem | undefined => coming()[0];

  function set(on: boolean): void {
    if (on === !page.hidden) return;
    page.hidden = !on;
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

  function choose(item: ReviewItem | undefined): void {
    if (item) current = keyOf(item);
    choosingClass = false;
    draw();
    list.querySelector<HTMLElement>('[aria-current="true"]')?.scrollIntoView({ block: "nearest" });
    if (item && shownKey !== versionOf(item)) {
      shownKey = versionOf(item);
      actions.show(item);
      void showImages(item);
    }
  }

  const versionOf = (item: ReviewItem) => `${keyOf(item)} ${item.version}`;
  const subjectOf = (item: ReviewItem) => {
    const key = versionOf(item);
    const found = subjects.get(key) ?? actions.subject(item);
    subjects.set(key, found);
    found.catch(() => subjects.delete(key));
    return found;
  };

  async function showImages(item: ReviewItem): Promise<void> {
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
    button.setAttribute("aria-label", `Review: ${count === null ? "number of items unknown" : plural(count, "item")}`);
    if (page.hidden) return;
    const rows = items.flatMap((item, i) => {
      const verdict = verdicts.get(keyOf(item));
      const state = verdict ? { saving: `${verdict.text}, saving …`, saved: `${verdict.text} ✓`, failed: "not saved", withdrawing: "withdrawing …" }[verdict.state] : aside.has(keyOf(item)) ? "skipped" : "";
      const row = el("li", { class: verdict?.state ?? "", data: { item: item.feature_id ? shortId(item.feature_id) : item.drive_id } }, el("button", { type: "button", onclick: () => choose(item) },
        el("b", { class: item.feature_id ? "mono" : "", textContent: item.feature_id ? shortId(item.feature_id) : item.drive_id }), el("i", { textContent: state }),
        el("small", { textContent: item.checks[0]?.name ?? `${item.drive_id} · ${utc(item.at, false)} UTC` }))); // prettier-ignore
      row.setAttribute("aria-current", String(keyOf(item) === current));
      return items[i - 1]?.kind === item.kind ? [row] : [el("li", { class: "heading" }, el("h3", { textContent: KINDS[item.kind].heading })), row];
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
    const verdict = verdicts.get(keyOf(item));
    question.textContent = KINDS[item.kind].question;
    why.textContent = [item.why, ...item.checks.map((c) => c.figures && `${c.name}: ${c.figures}`)].filter(Boolean).join(" ");
    note.hidden = !actions.writable() || asking !== null;
    if (asking?.isConnected) return; // somebody is typing
    const focused = buttons.contains(document.activeElement);
    fill(buttons, ...(asking ? [asking] : !actions.writable() ? [el("p", { class: "hint", textContent: writer.person() === null ? "Read-only: decisions require `conetl view --decisions`." : "Read-only: decisions require the role review, and `conetl view --decisions`." }), ...moves()] : item.kind === "held" && !actions.decidesDrives() ? [el("p", { class: "hint", textContent: "Decisions about whole drives require the role admin." }), ...moves()] : choosingClass ? classButtons(item) : verdict && verdict.state !== "failed" ? judged(verdict, item) : answers(item, verdict)));
    if (focused && !asking) buttons.querySelector<HTMLElement>("button")?.focus();
  }

  const moves = () => [keyButton("Skip", "", "S", skip), keyButton("Back", "", "B", () => go(-1))];

  const answers = (item: ReviewItem, verdict: Verdict | undefined) => [
    ...(verdict ? [el("p", { class: "hint bad", role: "alert", textContent: `“${verdict.text}” was not saved. ${verdict.problem}` })] : []),
    keyButton("Accept:", KINDS[item.kind].accept.text, "A", () => judge(item, KINDS[item.kind].accept)),
    keyButton("Reject:", KINDS[item.kind].reject.text, "R", () => judge(item, KINDS[item.kind].reject)),
    ...(classesOf(item).length ? [keyButton("Class …", "", "C", () => chooseClass(true))] : []),
    ...moves(),
  ];

  const judged = (verdict: Verdict, item: ReviewItem) => [
    el("p", { class: "hint", textContent: verdict.state === "saved" ? `Judged: ${verdict.text}. Saved.` : `Judged: ${verdict.text}. Saving …` }),
    ...(verdict.state === "saved" && verdict.decisionId ? [keyButton("Withdraw", "", "W", () => withdraw(item))] : []),
    keyButton("Next", "", "S", () => choose(following())), keyButton("Back", "", "B", () => go(-1)),
  ]; // prettier-ignore

  const classesOf = (item: ReviewItem) => (item.feature_id === null || item.kind === "removal" ? [] : [...CLASSES.keys()].filter((c) => c !== "lane_marking" && c !== item.category));

  const classButtons = (item: ReviewItem) => [
    ...classesOf(item).map((category, i) => keyButton(classOf(category).label, "", String(i + 1), () => judge(item, ofClass(category)))),
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

  function judge(item: ReviewItem, answer: Answer): void {
    const token = writer.token();
    if (token === null) return ask(form("", () => judge(item, answer)));
    const request = answer.request(item, signed(REASON));
    const verdict: Verdict = { text: answer.done, state: "saving", problem: "", decisionId: null };
    verdicts.set(keyOf(item), verdict);
    save(async () => {
      try {
        const done = await api.decide(map, request, writer.token() ?? token);
        verdict.decisionId = done.decision_id;
        if (done.versions_written) subjects.clear();
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

  function withdraw(item: ReviewItem): void {
    const verdict = verdicts.get(keyOf(item));
    if (!verdict?.decisionId || verdict.state !== "saved") return;
    const request: DecisionRequest = { kind: "withdraw", decision_id: verdict.decisionId, ...signed("withdrawn in the review") };
    verdict.state = "withdrawing";
    save(async () => {
      try {
        await api.decide(map, request, writer.token() ?? "");
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
      if (!writing) actions.decided();
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
    const item = chosen();
    const digit = choosingClass && item ? classesOf(item)[Number(key) - 1] : undefined;
    if (item && digit) return judge(item, ofClass(digit)), true;
    const wanted = [...page.querySelectorAll<HTMLButtonElement>(".review-buttons button, .review-head button")].find((b) => b.querySelector("kbd")?.textContent?.toLowerCase() === key);
    wanted?.click();
    return wanted !== undefined;
  }

  return {
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
