// The review queue: drives on hold and uncertain changes. Decisions go to the server; this browser remembers what was skipped, or
// accepted without a decision.
import { createDecider, type Choice, type DecideContext } from "./decisions";
import { el, fill, messageOf, plural, probabilityText, shortId, utc } from "./dom";
import { judging, type ReviewItem, type ReviewKind } from "./judging";
import type { Tab } from "./list_pane";

export interface ReviewActions {
  map(): string;
  writable(): boolean;
  /** Show a cone after the drive that changed it, or a drive on hold. */
  show(item: ReviewItem): void;
  openImages(item: ReviewItem): void;
  decided(): void;
  said(text: string): void;
}

const HEADINGS: Record<ReviewKind, string> = {
  held: "Drives on hold", removal: "Removed cones", move: "Moved by 1 m or more", doubtful: "Existence 0.3 to 0.7",
};
const PAGE = 100;
/** More than a person reviews in a day; the badge then says so. */
const MOST = 500;

const keyOf = (i: ReviewItem) => `${i.kind} ${i.feature_id ?? i.changeset_id ?? ""} ${i.changeset_no}`;

export function createReview(tab: (render: (host: HTMLElement) => void) => Tab, actions: ReviewActions) {
  const badge = el("b", { class: "badge", textContent: "…", data: { count: "" } });
  const button = el("button", { type: "button", class: "link review-button", title: "Drives and changes to review", onclick: () => open() }, el("span", { textContent: "Review " }), badge);
  const list = el("ol", { class: "review-items" });
  const about = el("div", {});
  const buttons = el("div", { class: "review-actions" });
  const skip = el("button", { type: "button", textContent: "Skip (S)", title: "Decide later; only this browser remembers it", onclick: () => putAside() });
  const agree = el("button", { type: "button", textContent: "Accept (A)", onclick: () => putAside() });
  const images = el("button", { type: "button", textContent: "Images (I)", onclick: () => openImages() });
  const deciderHost = el("div", {});
  const decider = createDecider(deciderHost);
  buttons.append(agree, deciderHost, skip, images);
  const detail = el("div", { class: "review-detail", aria: { live: "polite" } }, about, buttons);
  const body = el("div", { class: "review" }, list, detail);
  const own = tab((host) => fill(host, body));

  let items: ReviewItem[] = [];
  /** null until the server has said it. */
  let total: number | null = null;
  let map = "";
  let current: string | null = null;
  let failed = "";
  let loadNo = 0;
  /** Opened before the queue was read: its first item is chosen once it is there. */
  let early = false;

  const store = () => `conetl review ${actions.map()}`;
  const skipped = (): Set<string> => {
    try {
      return new Set(JSON.parse(localStorage.getItem(store()) ?? "[]") as string[]);
    } catch {
      return new Set();
    }
  };
  const waiting = (): ReviewItem[] => {
    const aside = skipped();
    return items.filter((i) => !aside.has(keyOf(i)));
  };
  const chosen = () => waiting().find((i) => keyOf(i) === current);

  async function load(): Promise<void> {
    const mine = ++loadNo;
    const found: ReviewItem[] = [];
    if (map !== actions.map()) {
      [map, items, total, current] = [actions.map(), [], null, null];
      draw();
    }
    try {
      do {
        const page = await judging.review(actions.map(), found.length, PAGE);
        if (mine !== loadNo) return;
        total = Object.values(page.counts).reduce((a, b) => a + b, 0);
        found.push(...page.items);
        if (!page.items.length) break;
        if (items.length < found.length) items = [...found];
        draw();
      } while (found.length < Math.min(total, MOST));
      items = found;
      failed = "";
    } catch (error) {
      if (mine !== loadNo) return;
      failed = messageOf(error);
    }
    draw();
    if (early) chooseFirst();
    early = false;
  }

  function draw(): void {
    const open = waiting();
    const count = total === null ? null : open.length + Math.max(total - items.length, 0);
    badge.textContent = count === null ? (failed ? "?" : "…") : count.toLocaleString("en");
    badge.dataset["count"] = String(count ?? "");
    button.setAttribute("aria-label", `Review: ${count === null ? "number of items unknown" : plural(count, "item")}`);
    own.count(count);
    const hidden = items.length - open.length;
    const rows = open.flatMap((item, i) => {
      const row = el("li", {}, el("button", { type: "button", onclick: () => choose(item) },
        el("b", { class: item.feature_id ? "mono" : "", textContent: item.feature_id ? shortId(item.feature_id) : item.drive_id }),
        el("span", { textContent: item.existence_probability === null ? (item.checks[0]?.figures ?? "") : `existence ${probabilityText(item.existence_probability)}` }),
        el("small", { textContent: item.checks[0]?.name ?? `${item.drive_id} · ${utc(item.at, false)} UTC` }))); // prettier-ignore
      row.setAttribute("aria-current", String(keyOf(item) === current));
      return open[i - 1]?.kind === item.kind ? [row] : [el("li", {}, el("h4", { textContent: HEADINGS[item.kind] })), row];
    });
    const restore = el("button", { type: "button", class: "link", textContent: `Show ${plural(hidden, "skipped item")}`, onclick: () => (localStorage.removeItem(store()), draw()) });
    fill(list, ...rows, Boolean(failed) && el("li", { class: "hint bad", textContent: failed }), hidden > 0 && el("li", {}, restore));
    drawDetail();
  }

  function drawDetail(): void {
    const item = chosen();
    buttons.hidden = !item;
    if (!item) return fill(about, el("p", { class: "hint", textContent: waiting().length ? "Select an item (↑ ↓), then accept (A), reject (R) or skip (S) it." : total === null ? "Loading …" : "Nothing to review." }));
    const figures = item.checks.map((c) => el("tr", {}, el("th", { textContent: c.name }), el("td", { class: "mono", textContent: c.figures || "not measured" })));
    fill(about, el("p", { class: "why", textContent: item.why }), figures.length > 0 && el("table", {}, ...figures),
      el("p", { class: "hint", textContent: meaning(item) })); // prettier-ignore
    agree.hidden = !(item.kind === "removal" || item.kind === "move");
    const context: DecideContext = { map: actions.map(), changed: () => (actions.decided(), void load()), wrote: (text) => (next(), actions.said(text)) };
    decider.show(`${keyOf(item).replaceAll(" ", "_")} ${String(item.version)} ${String(actions.writable())}`, actions.writable() ? choices(item) : [], context);
    if (!actions.writable()) about.append(el("p", { class: "hint", textContent: "Read-only: decisions require `conetl view --decisions`." }));
  }

  function openImages(): boolean {
    const item = chosen();
    if (item) actions.openImages(item);
    return item !== undefined;
  }

  function open(): void {
    own.show();
    early = !chooseFirst();
  }

  function chooseFirst(): boolean {
    const first = chosen() ?? waiting()[0];
    if (first) choose(first);
    return first !== undefined;
  }

  function choose(item: ReviewItem): void {
    current = keyOf(item);
    draw();
    list.querySelector<HTMLElement>('[aria-current="true"]')?.scrollIntoView({ block: "nearest" });
    actions.show(item);
  }

  /** The item after the current one, which is leaving. */
  function next(): void {
    const open_ = waiting();
    const at = open_.findIndex((i) => keyOf(i) === current);
    const item = open_[at + 1] ?? open_[at - 1];
    current = item ? keyOf(item) : null;
  }

  function putAside(): void {
    const item = chosen();
    if (!item) return;
    next();
    localStorage.setItem(store(), JSON.stringify([...skipped(), keyOf(item)].slice(-5000)));
    draw();
    const following = chosen();
    if (following) actions.show(following);
  }

  function press(which: "accept" | "reject"): void {
    const item = chosen();
    if (!item) return;
    if (which === "accept" && !agree.hidden) return putAside();
    const all = deciderHost.querySelectorAll<HTMLButtonElement>(".decide-buttons button");
    (which === "accept" ? all[0] : all[all.length - 1])?.click();
  }

  return {
    button,
    load: () => void load(),
    /** Keys while the queue is visible. */
    key(event: KeyboardEvent): boolean {
      if (!own.visible || event.shiftKey) return false;
      const open_ = waiting();
      const at = open_.findIndex((i) => keyOf(i) === current);
      const to = event.key === "ArrowDown" ? open_[at + 1] : event.key === "ArrowUp" ? open_[at - 1] : undefined;
      switch (event.key.toLowerCase()) {
        case "a": press("accept"); return true;
        case "r": press("reject"); return true;
        case "s": putAside(); return true;
        case "i": return chosen()?.kind === "held" && openImages();
        case "arrowdown": case "arrowup":
          if (!list.contains(document.activeElement) || !to) return false;
          choose(to);
          list.querySelector<HTMLElement>('[aria-current="true"] button')?.focus();
          return true;
        default: return false;
      }
    },
  };
}

function meaning(item: ReviewItem): string {
  switch (item.kind) {
    case "held": return "Accept: merge the drive into the map. Reject: keep it out of the map. Skip: leave it on hold.";
    case "removal": return "Accept: the cone is gone; only this browser remembers that you agreed. Reject: the cone still stands; a pin puts it back.";
    case "move": return "Accept: the new position is right; only this browser remembers that you agreed. Reject: no cone stands there; the position is suppressed.";
    case "doubtful": return "Accept: the cone stands and is pinned. Reject: no cone stands there; the position is suppressed.";
  }
}

function choices(item: ReviewItem): Choice[] {
  const { changeset_id: changeset, feature_id: feature, version } = item;
  const text = (accept: boolean) => (accept ? "Accept … (A)" : "Reject … (R)");
  if (item.kind === "held" && changeset !== null)
    return [
      { text: text(true), explain: `Merges ${item.drive_id} into the map although a health check failed.`, submit: "Accept the drive", done: "Accepted.",
        request: ({ decided_by, reason }) => ({ kind: "accept", changeset_id: changeset, decided_by, reason }) },
      { text: text(false), explain: `Keeps ${item.drive_id} out of the map. You can withdraw the decision.`, submit: "Revert the drive", done: "Reverted.",
        request: ({ decided_by, reason }) => ({ kind: "revert", changeset_id: changeset, decided_by, reason }) },
    ]; // prettier-ignore
  if (feature === null || version === null) return [];
  const place = (kind: "pin" | "suppress", accept: boolean): Choice => ({
    text: text(accept), withRadius: true, done: kind === "pin" ? "Pinned." : "Suppressed.", submit: kind === "pin" ? "Pin this cone" : "Suppress this position",
    explain: kind === "pin" ? "Keeps this cone on the map at this position. Later drives can confirm it, but not move or remove it." : "Removes this cone from the map. Later drives do not add one here again.",
    request: (by) => ({ kind, feature_id: feature, expected_version: version, ...by }),
  });
  if (item.kind === "removal") return [place("pin", false)];
  return item.kind === "move" ? [place("suppress", false)] : [place("pin", true), place("suppress", false)];
}
