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

const RETRY_MS = 10_000;

/** Listen until the returned function is called. */
export function listen(map: string, on: LiveHandlers): () => void {
  let source: EventSource | null = null;
  let timer = 0;
  let ended = false;

  function open(): void {
    source = api.events(map);
    source.addEventListener("changeset", (event: MessageEvent<string>) => {
      on.status("live", "New drives appear as soon as they are committed.");
      on.newest(Number(event.data));
    });
    source.addEventListener("decision", (event: MessageEvent<string>) => on.decided(Number(event.data)));
    source.addEventListener("base", (event: MessageEvent<string>) => on.base(event.data));
    source.addEventListener("trouble", (event: MessageEvent<string>) => on.status("trouble", event.data));
    source.addEventListener("error", () => {
      on.status("waiting", "No connection to the server: new drives do not appear. Trying again …");
      if (source?.readyState === EventSource.CLOSED && !ended) timer = window.setTimeout(open, RETRY_MS);
    });
  }

  open();
  return () => {
    ended = true;
    window.clearTimeout(timer);
    source?.close();
  };
}
