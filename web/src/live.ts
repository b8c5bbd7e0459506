// The stream of new changesets, decisions and base layers. The browser reconnects itself, except after a refusal: then this retries.
import { api } from "./api";

export type LiveStatus = "live" | "waiting" | "trouble";

export interface LiveHandlers {
  newest(changesetNo: number): void;
  /** Number of the newest decision, at once and after each change. */
  decided(decisionNo: number): void;
  /** A text that changes with the base layers, at once and after each change. */
  base(head: string): void;
  status(status: LiveStatus, text: string): void;
}

const RETRY_MS = 3_000;
const clock = (t: Date) => t.toLocaleTimeString([], { hour: "2-digit", minute: "2-digit", second: "2-digit" });

/** Listen until the returned function is called. */
export function listen(map: string, on: LiveHandlers): () => void {
  let source: EventSource | null = null;
  let timer = 0;
  let lostAt: Date | null = null;
  let ended = false;

  function open(): void {
    source = api.events(map);
    source.addEventListener("open", () => (lostAt = null));
    source.addEventListener("changeset", (event: MessageEvent<string>) => {
      on.status("live", "New drives appear as soon as they are saved.");
      on.newest(Number(event.data));
    });
    source.addEventListener("decision", (event: MessageEvent<string>) => on.decided(Number(event.data)));
    source.addEventListener("base", (event: MessageEvent<string>) => on.base(event.data));
    source.addEventListener("trouble", (event: MessageEvent<string>) => on.status("trouble", event.data));
    source.addEventListener("error", () => {
      if (ended) return;
      lostAt ??= new Date();
      on.status("waiting", `No connection to the server since ${clock(lostAt)}: this is the map as it was then. Trying again …`);
      if (source?.readyState === EventSource.CLOSED) timer = window.setTimeout(() => void reopen(), RETRY_MS);
    });
  }

  /** A refused stream does not say why; a request does, and asks for a login that has expired. */
  async function reopen(): Promise<void> {
    await api.maps().catch(() => undefined);
    if (!ended) open();
  }

  open();
  return () => {
    ended = true;
    window.clearTimeout(timer);
    source?.close();
  };
}
