// The stream of new changesets. The browser reconnects by itself; where the server refused for good, this tries again.
import { api } from "./api";

export type LiveStatus = "live" | "waiting" | "trouble";

export interface LiveHandlers {
  newest(changesetNo: number): void;
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
      on.status("live", "New drives appear here as soon as they are committed.");
      on.newest(Number(event.data));
    });
    source.addEventListener("trouble", (event: MessageEvent<string>) => on.status("trouble", event.data));
    source.addEventListener("error", () => {
      on.status("waiting", "No connection for news: new drives do not appear until there is one. Trying again …");
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
