// The button “Share”: a link to what is shown, and where the operator allows it the code of a frame. The page in such a frame.
import { el } from "./dom";
import { copyText } from "./measure";

/** In a frame of another page: the map alone, and no decisions. */
export const EMBEDDED = location.pathname.endsWith("/embed.html");

export interface ShareActions {
  /** Write the address now: it may lag behind the camera. */
  write(): void;
  mayEmbed(): boolean;
  said(text: string, action: { text: string; run: () => void } | null): void;
}

export function shareButton(actions: ShareActions): HTMLButtonElement {
  async function share(text: string, said: string, next: { text: string; run: () => void } | null): Promise<void> {
    await copyText(text);
    actions.said(said, next);
  }
  const frame = () => {
    const src = new URL("embed.html", location.href).href + location.hash;
    void share(`<iframe src="${src.replaceAll("&", "&amp;").replaceAll('"', "&quot;")}" title="${document.title}" width="800" height="500"></iframe>`, "The code of a frame is copied. It shows this view, read-only.", null);
  };
  return el("button", { type: "button", class: "link", id: "share", textContent: "Share", title: "Copy a link that opens this view", onclick: () => {
    actions.write();
    void share(location.href, "The link is copied. It opens this view.", actions.mayEmbed() ? { text: "Copy code of a frame", run: frame } : null);
  } }); // prettier-ignore
}

/** The way from a frame to the whole map viewer, with the same view. */
export const wholeLink = (): HTMLAnchorElement =>
  el("a", { class: "whole-link", target: "_blank", rel: "noopener", textContent: "Open the map viewer", href: "./", onclick: (event) => {
    (event.currentTarget as HTMLAnchorElement).href = `./${location.hash}`;
  } }); // prettier-ignore
