// Decisions of people: suppress, pin, revert, and taking them back. Only for holders of the writer token, which the page keeps for this
// tab once a person typed it, and sends in a header only.
import { api, ApiError, type Decision, type Decisions, type HistoryItem, type DecisionRequest, type TimelineItem } from "./api";
import { el, fill, plural, when } from "./dom";
import { STYLES } from "./kinds";

const TOKEN = "conetl writer token";
const NAME = "conetl name";

let person: string | null = null;

/** Who decides in this tab: who is logged in by name, else as typed once, and accepted by the server. */
export const writer = {
  /** null: nobody by name; a person needs no token. */
  logIn: (name: string | null): void => void (person = name),
  person: () => person,
  name: () => person ?? sessionStorage.getItem(NAME) ?? "",
  token: () => (person === null ? sessionStorage.getItem(TOKEN) : ""),
  keep(name: string, token: string): void {
    sessionStorage.setItem(NAME, name);
    sessionStorage.setItem(TOKEN, token);
  },
  /** The server refused the token. */
  forget: () => sessionStorage.removeItem(TOKEN),
};

export interface DecideContext {
  map: string;
  /** Something was written, or changed meanwhile: read it again. */
  changed(): void;
}

export interface Choice {
  /** Text of the button that opens the form. */
  text: string;
  /** The effect, in a sentence. */
  explain: string;
  /** Text of the button that writes. */
  submit: string;
  withRadius?: boolean;
  request(by: { decided_by: string; reason: string; radius_m: number }): DecisionRequest;
  /** Message of success. */
  done: string;
}

/** A decision about a position concerns either lane markings or the object that stands there. */
export function aboutFeature(all: Decision[], id: string, xyz: [number, number, number] | undefined, isLine: boolean): Decision[] {
  return all.filter((d) => {
    if (d.changeset_id !== null) return false;
    if (d.feature_id === id) return true;
    return xyz !== undefined && d.of_line === isLine && d.xy_m !== null && Math.hypot(d.xy_m[0] - xyz[0], d.xy_m[1] - xyz[1]) <= (d.radius_m ?? 0);
  });
}

export const placeChoice = (kind: "suppress" | "pin", id: string, version: number, noun: string): Choice => ({
  text: kind === "suppress" ? "Suppress …" : "Pin …",
  explain:
    kind === "suppress"
      ? `Removes this ${noun} from the map and keeps its history. Later drives do not add one here again.`
      : `Keeps this ${noun} on the map at this position. Later drives can confirm it, but not move or remove it.`,
  submit: `${kind === "suppress" ? "Suppress" : "Pin"} this ${noun}`,
  withRadius: true,
  request: (by) => ({ kind, feature_id: id, expected_version: version, ...by }),
  done: kind === "suppress" ? "Suppressed." : "Pinned.",
});

const WITHDRAWALS: Record<Decision["kind"], [text: string, submit: string, explain: string]> = {
  suppress: ["Withdraw …", "Withdraw the decision", "Drives update this position again."],
  classify: ["Withdraw …", "Withdraw the decision", "The detector decides the class again."],
  approve: ["Withdraw …", "Withdraw the approval", "The change waits for review again."],
  pin: ["Unpin …", "Unpin", "Drives update this position again."],
  revert: ["Withdraw …", "Withdraw the decision", "The drive is merged into the map again."],
  accept: ["Withdraw …", "Withdraw the decision", "The drive goes on hold again if its health checks still fail."],
  hold: ["Accept …", "Accept the drive", "The drive is merged into the map although a health check failed."],
};

export const withdrawChoice = (d: Decision): Choice => ({
  text: WITHDRAWALS[d.kind][0],
  submit: WITHDRAWALS[d.kind][1],
  explain: WITHDRAWALS[d.kind][2],
  request: ({ decided_by, reason }) =>
    d.kind === "hold" && d.changeset_id !== null
      ? { kind: "accept", changeset_id: d.changeset_id, decided_by, reason }
      : { kind: "withdraw", decision_id: d.decision_id, decided_by, reason },
  done: d.kind === "hold" ? "Accepted." : "Withdrawn.",
});

export const revertChoice = ({ changeset_id, drive_id, kind }: TimelineItem): Choice => ({
  text: `Revert ${kind} …`,
  explain: `Takes ${drive_id} out of the map. Observations of other drives stay, and you can withdraw the decision.`,
  submit: `Revert this ${kind}`,
  request: ({ decided_by, reason }) => ({ kind: "revert", changeset_id, decided_by, reason }),
  done: "Reverted.",
});

const LABELS: Record<Decision["kind"], string> = { suppress: "Suppressed", pin: "Pinned", classify: "Class corrected", approve: "Approved", revert: "Reverted", accept: "Accepted", hold: "On hold" };

/** "Pinned by Ada: stands on a kerb", with the time. */
export function sentence(d: Decision): HTMLElement {
  return el("div", { class: "decision" },
    el("b", { textContent: `${LABELS[d.kind]}${d.drive_id ? ` ${d.drive_id}` : ""}` }), ` by ${d.decided_by ?? (d.kind === "hold" ? "the health checks" : "unknown")}`,
    Boolean(d.reason) && `: ${d.reason}`, el("small", { textContent: `${when(d.decided_at)}${d.radius_m === null ? "" : ` · within ${d.radius_m} m`}` })); // prettier-ignore
}

/** Buttons that each open a form below them; one form at a time. They stay open while `about` is the same. */
export function createDecider(host: HTMLElement) {
  const status = el("p", { class: "decide-status", role: "status", aria: { live: "polite" }, hidden: true });
  const buttons = el("div", { class: "decide-buttons" });
  const formHost = el("div", {});
  host.append(buttons, el("div", { class: "decide-popup" }, formHost, status));
  let key = "";
  let busy = false;

  function report(text: string, bad: boolean): void {
    status.hidden = !text;
    status.textContent = text;
    status.classList.toggle("bad", bad);
    status.classList.toggle("good", Boolean(text) && !bad);
  }

  function show(about: string, choices: Choice[], context: DecideContext): void {
    if (about === key) return;
    const sameThing = about.split(" ")[0] === key.split(" ")[0];
    key = about;
    if (!sameThing) report("", false);
    fill(formHost);
    const focused = buttons.contains(document.activeElement);
    fill(buttons, ...choices.map((choice) => {
      const button = el("button", { type: "button", textContent: choice.text, aria: { expanded: "false" } });
      button.addEventListener("click", () => toggle(choice, button, context));
      return button;
    })); // prettier-ignore
    if (focused) buttons.querySelector("button")?.focus();
  }

  function close(focus: HTMLElement | null): void {
    fill(formHost);
    report("", false);
    for (const b of buttons.children) b.setAttribute("aria-expanded", "false");
    focus?.focus();
  }

  function toggle(choice: Choice, button: HTMLElement, context: DecideContext): void {
    const wasOpen = button.getAttribute("aria-expanded") === "true";
    close(null);
    if (wasOpen) return;
    button.setAttribute("aria-expanded", "true");
    const form = makeForm(choice, context, () => close(button));
    fill(formHost, form);
    form.querySelector<HTMLInputElement>("input:placeholder-shown")?.focus(); // the first empty one
  }

  function makeForm(choice: Choice, context: DecideContext, cancel: () => void): HTMLFormElement {
    const text = (props: Record<string, unknown>) => el("input", { type: "text", required: true, autocomplete: "off", placeholder: " ", ...props });
    const name = text({ name: "name", value: writer.name(), minLength: 2, maxLength: 80, autocomplete: "name" });
    name.readOnly = writer.person() !== null;
    const reason = text({ name: "reason", minLength: 3, maxLength: 500 });
    const radius = el("input", { type: "number", name: "radius", value: "1", min: "0.1", max: "20", step: "0.1", required: true });
    const token = text({ name: "token", type: "password", autocomplete: "off" });
    const tokenRow = label("Writer token", token, "In the file that conetl view names when it starts. Kept for this tab only.");
    if (writer.token() !== null) {
      token.required = false;
      tokenRow.hidden = true;
    }
    const submit = el("button", { type: "submit", class: "primary", textContent: choice.submit });
    const abort = el("button", { type: "button", textContent: "Cancel", onclick: cancel });
    const form = el("form", { class: "decide", noValidate: false },
      el("p", { class: "hint", textContent: choice.explain }),
      label("Your name", name), label("Reason", reason, "Name and reason are visible to everyone who sees the map."),
      choice.withRadius && label("Radius (m)", radius), tokenRow,
      el("div", { class: "decide-actions" }, submit, abort)); // prettier-ignore
    form.addEventListener("keydown", (event) => {
      if (event.key !== "Escape") return;
      event.stopPropagation(); // closes the form, not the panel
      if (!busy) cancel();
    });
    form.addEventListener("submit", (event) => {
      event.preventDefault();
      if (!busy) void write();
    });

    const typed = () => (tokenRow.hidden ? (writer.token() ?? "") : token.value.trim());

    async function write(): Promise<void> {
      const secret = typed();
      const by = { decided_by: name.value.trim(), reason: reason.value.trim(), radius_m: Number(radius.value) };
      busy = true;
      for (const input of [name, reason, radius, token, abort]) input.disabled = true;
      submit.disabled = true;
      submit.textContent = "Writing …";
      report("", false);
      try {
        const done = await api.decide(context.map, choice.request(by), secret);
        remember();
        cancel();
        const said = [`${choice.done} ${plural(done.versions_written, "feature version")} written, ${plural(done.replayed, "drive")} replayed.`, ...done.hold_changes, done.report_problem].filter(Boolean).join(" "); // prettier-ignore
        report(said, done.report_problem !== null);
        context.changed();
      } catch (error) {
        refused(error);
      } finally {
        busy = false;
      }
    }

    /** Once the server accepted the token, even if it refused the decision. */
    function remember(): void {
      writer.keep(name.value.trim(), typed());
    }

    function refused(error: unknown): void {
      if (error instanceof ApiError && ![0, 401, 403].includes(error.status)) remember();
      for (const input of [name, reason, radius, token, abort]) input.disabled = false;
      submit.disabled = false;
      submit.textContent = choice.submit;
      const message = error instanceof Error ? error.message : String(error);
      if (error instanceof ApiError && error.status === 401) {
        writer.forget();
        tokenRow.hidden = false;
        token.required = true;
        token.value = "";
        token.focus();
        return report(`Nothing was written. ${message}`, true);
      }
      if (error instanceof ApiError && error.status === 409) {
        cancel();
        report(`Nothing was written. ${message}${currentState(error.body)}`, true);
        return context.changed();
      }
      submit.focus();
      report(`Nothing was written. ${message}`, true);
    }

    return form;
  }

  return { show };
}

export function label(text: string, input: HTMLInputElement, hint = ""): HTMLElement {
  return el("label", {}, el("span", { textContent: text }), input, Boolean(hint) && el("small", { textContent: hint }));
}

/** The state that the server reports. */
function currentState(body: unknown): string {
  const now = typeof body === "object" && body !== null && "now" in body ? (body.now as HistoryItem | null) : null;
  if (!now) return "";
  const [easting, northing] = now.map_xyz_m;
  return ` It is now version ${now.version}, ${STYLES[now.kind].label} by ${now.drive_id}, at ${easting.toFixed(3)} E ${northing.toFixed(3)} N.`;
}

/** The section of the sidebar that lists the decisions in effect. */
export function createDecisionList(host: HTMLElement, open: (d: Decision) => void) {
  return (answer: Decisions | null): void => {
    host.hidden = !answer?.decisions.length;
    if (!answer) return;
    fill(host, el("h2", { textContent: "Decisions" }),
      ...answer.decisions.slice(0, 50).map((d) =>
        el("button", { type: "button", class: "decision-row", title: "Show", onclick: () => open(d) }, sentence(d))),
      answer.decisions.length > 50 && el("p", { class: "hint", textContent: `${answer.decisions.length - 50} older decisions: run conetl map decisions to list them.` })); // prettier-ignore
  };
}
