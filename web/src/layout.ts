// The frame of the page: header, side panels, cards for empty maps, loading and errors.
import { classOf, onlyCones } from "./classes";
import { el, fill, lengthText, messageOf, plural, shortId, sureText } from "./dom";
import { icon, STYLES, type Cone } from "./kinds";
import { createListPane } from "./list_pane";
import type { LiveStatus } from "./live";
import { EMBEDDED, wholeLink } from "./share";
import { wordsOf } from "./markings";

interface CardOptions {
  busy?: boolean;
  code?: string;
  action?: { text: string; run: () => void };
}

const SHORTCUTS: [string, string][] = [
  ["Drag, right drag, wheel", "rotate, pan, zoom"],
  ["← ↑ → ↓, with Shift", "pan, rotate"],
  ["+ −", "zoom"],
  ["Home", "show everything"],
  ["T", "plan (north up) or 3D"],
  ["M", "measure"],
  ["X", "copy the coordinates under the cursor"],
  [",  .", "previous, next drive"],
  ["B, C", "before or after the drive, changes"],
  ["1, 2", "show or hide LiDAR points, lane boundaries"],
  ["P, N", "previous, next image along the drive"],
  ["I, F, V", "full images of the selected cone, camera follows image, before and after as a swipe"],
  ["R, D", "review changes, differences from plans"],
  ["/", "search"],
  ["L", "open or close the list"],
  ["[  ] or K, J", "previous, next row of the list"],
  ["Esc", "close what is open"],
];
const STATUS_TEXT: Record<LiveStatus, string> = { live: "live", waiting: "no connection", trouble: "database error" };

export function createLayout(app: HTMLElement) {
  const view = el("main", { class: "view" });
  const sidebar = el("aside", { class: "sidebar", id: "sidebar", aria: { label: "Map and legend" } });
  const panel = el("aside", { class: "panel", hidden: true, aria: { label: "Selected object" } });
  const list = el("section", { class: "list", hidden: true, aria: { label: "Lists" } });
  const listButton = el("button", { type: "button", class: "link", aria: { expanded: "false" } }, "List ", el("kbd", { textContent: "L" }));
  const listPane = createListPane(list, listButton);
  /** Parts of the header that other modules fill. */
  const tools = { search: el("div", { class: "tool-search" }), download: el("div", {}), more: el("div", { class: "tool-more" }) };
  const timeline = el("footer", { class: "timeline" });
  const brand = el("h1", { class: "brand" });
  const whoHost = el("span", { class: "who", hidden: true, title: "Logged in" });
  const dot = el("span", { class: "status", role: "status" }, el("i"), el("span", { textContent: "connecting" }));
  dot.dataset["status"] = "waiting";
  const progress = el("div", { class: "progress", hidden: true });
  const cardHost = el("div", { class: "card-host", hidden: true });
  const noticeHost = el("div", { class: "scene-notice", hidden: true, role: "status" });
  const toasts = el("div", { class: "toasts", aria: { live: "polite" } });
  const tip = el("div", { class: "tip", hidden: true, aria: { hidden: "true" } });
  let tipped: Cone | null = null;
  const token = el("input", { type: "password", name: "token", required: true, autocomplete: "current-password" });
  const refused = el("p", { class: "hint bad", role: "alert" });
  const loginForm = el("form", {}, el("h2", { textContent: "Log in again" }), el("p", { class: "hint", textContent: "The login has expired. `conetl status` prints the address with the token." }),
    el("label", {}, "Token ", token), refused, el("button", { type: "submit", class: "primary", textContent: "Log in" })); // prettier-ignore
  const loginDialog = el("dialog", { class: "help login" }, loginForm);
  let loggingIn: Promise<void> | null = null;
  const help = el("dialog", { class: "help" },
    el("h2", { textContent: "Shortcuts" }), el("dl", {}, ...SHORTCUTS.flatMap(([keys, what]) => [el("dt", { textContent: keys }), el("dd", { textContent: what })])),
    el("p", { class: "hint", textContent: "Cones are drawn with their measured height and a standard width; markers have a fixed size." }),
    el("button", { type: "button", textContent: "Close", onclick: () => help.close() })); // prettier-ignore
  const menu = el("button", { type: "button", class: "menu", textContent: "☰ Legend", aria: { expanded: "false", controls: "sidebar" } });
  const openMenu = (on: boolean) => {
    app.classList.toggle("menu-open", on);
    menu.setAttribute("aria-expanded", String(on));
  };
  menu.addEventListener("click", () => openMenu(!app.classList.contains("menu-open")));
  // On narrow screens the legend covers the map.
  document.addEventListener("pointerdown", (event) => {
    if (event.target instanceof Node && !sidebar.contains(event.target) && event.target !== menu) openMenu(false);
  });
  document.addEventListener("keydown", (event) => {
    if (event.key === "Escape") openMenu(false);
  });
  const helpButton = el("button", { type: "button", class: "link help-button", onclick: () => help.showModal() }, "Shortcuts ", el("kbd", { textContent: "?" }));
  app.append(
    el("header", { class: "top" }, menu, brand, tools.search, el("span", { class: "space" }), whoHost, dot, tools.download, listButton),
    progress, sidebar, view, panel, list, timeline, toasts, help, loginDialog,
  ); // prettier-ignore
  view.append(cardHost, noticeHost, tip);
  tools.more.append(helpButton);
  const narrow = window.matchMedia("(max-width: 760px)");
  /** Beside the other buttons of the header where there is room, else at the end of the legend. */
  const place = () => (narrow.matches ? sidebar : app.querySelector(".top"))?.append(tools.more);
  narrow.addEventListener("change", place);
  place();
  app.classList.toggle("embedded", EMBEDDED);
  if (EMBEDDED) view.append(wholeLink());

  function tell(cone: Cone): void {
    const shift = cone.kind === "moved" && cone.shift_m !== null ? ` by ${cone.shift_m.toFixed(2)} m` : "";
    fill(tip, el("b", {}, icon(cone.kind), `${STYLES[cone.kind].label}${shift}`), !onlyCones() && classOf(cone.category).label, cone.marking && el("span", { textContent: wordsOf(cone.marking) }), el("span", { class: "mono", textContent: shortId(cone.id) }),
      el("span", { textContent: `sure it stands: ${sureText(cone.probability)}, accuracy ±${lengthText(cone.sigma_m)}, ${plural(cone.observations, "observation")}` })); // prettier-ignore
  }

  return {
    app, view, sidebar, panel, timeline, brand, listPane, tools,
    busy: (on: boolean) => void (progress.hidden = !on),
    empty: (on: boolean) => void app.classList.toggle("is-empty", on),
    panelOpen: (on: boolean) => void app.classList.toggle("panel-open", on),
    card(title: string | null, text = "", options: CardOptions = {}): void {
      cardHost.hidden = title === null;
      if (title === null) return;
      const { action } = options;
      fill(cardHost, el("div", { class: options.busy ? "card busy" : "card", role: options.busy ? "status" : "alert" },
        el("h2", { textContent: title }), Boolean(text) && el("p", { textContent: text }),
        options.code && el("code", { textContent: options.code }),
        action && el("button", { type: "button", class: "primary", textContent: action.text, onclick: () => action.run() }))); // prettier-ignore
    },
    /** Ask for the token until `accepts` takes it; one dialog for all requests that wait. */
    logIn(accepts: (token: string) => Promise<boolean>): Promise<void> {
      loggingIn ??= new Promise<void>((done, fail) => {
        loginDialog.oncancel = () => fail(new Error("You are not logged in."));
        loginForm.onsubmit = (event) => {
          event.preventDefault();
          void accepts(token.value.trim()).then((right) => {
            refused.textContent = right ? "" : "This token is wrong.";
            token.value = "";
            if (right) done();
          }, (error: unknown) => (refused.textContent = messageOf(error))); // prettier-ignore
        };
        loginDialog.showModal();
      }).finally(() => {
        loginDialog.close();
        loggingIn = null;
      });
      return loggingIn;
    },
    notice(text: string | null): void {
      noticeHost.hidden = text === null;
      noticeHost.textContent = text;
    },
    toast(text: string, action: { text: string; run: () => void } | null): void {
      if ([...toasts.children].some((shown) => shown.firstChild?.textContent === text)) return;
      const node = el("div", { class: "toast" }, el("span", { textContent: text }));
      const remove = () => node.remove();
      if (action) node.append(el("button", { type: "button", class: "link", textContent: action.text, onclick: () => (action.run(), remove()) }));
      node.append(el("button", { type: "button", class: "link", textContent: "×", aria: { label: "Dismiss" }, onclick: remove }));
      toasts.append(node);
      window.setTimeout(remove, action ? 60_000 : 8_000);
    },
    status(status: LiveStatus, text: string): void {
      dot.dataset["status"] = status;
      dot.title = text;
      const word = dot.lastElementChild;
      if (word && word.textContent !== STATUS_TEXT[status]) word.textContent = STATUS_TEXT[status];
    },
    tip(cone: Cone | null, x: number, y: number): void {
      tip.hidden = cone === null;
      if (!cone) return;
      if (cone !== tipped) tell((tipped = cone));
      const left = x + 14 + tip.offsetWidth > view.clientWidth ? x - 14 - tip.offsetWidth : x + 14;
      tip.style.transform = `translate(${left}px, ${Math.max(4, y - tip.offsetHeight / 2)}px)`;
    },
    /** Who is logged in by name. */
    person(name: string | null): void {
      whoHost.hidden = name === null;
      whoHost.textContent = name;
    },
    openHelp: () => void (help.open || help.showModal()),
    closeHelp: (): boolean => {
      const open = help.open;
      if (open) help.close();
      return open;
    },
  };
}
export type Layout = ReturnType<typeof createLayout>;
