// The menu “Download”: files of the state that is shown, an image of the view, the report of the drive.
import { api, ApiError, detailOf, type Instant, type TimelineItem } from "./api";
import { countOf } from "./classes";
import { el, fill, messageOf, popup, utc } from "./dom";

export interface Shown {
  map: string;
  title: string;
  at: Instant;
  /** Compare: the earlier time. */
  since: string | null;
  /** The drive that is shown; null without one. */
  drive: TimelineItem | null;
  coneCount: number;
  /** West, south, east, north of what is in the view, in the map's CRS. */
  box: [number, number, number, number] | null;
}

export interface DownloadActions {
  shown(): Shown | null;
  picture(): Promise<Blob>;
  failed(message: string): void;
}

/** Formats with the usual bytes per cone. */
const FORMATS: [string, string, number][] = [["geojson", "GeoJSON", 850], ["csv", "CSV", 420], ["gpkg", "GeoPackage", 500]]; // prettier-ignore
const REMEMBERED = "conetl.feed";

export function createDownloads(host: HTMLElement, actions: DownloadActions) {
  const button = el("button", { type: "button", class: "link", aria: { expanded: "false", controls: "downloads" } }, "Download");
  const menu = el("div", { class: "menu-popup", id: "downloads", hidden: true, role: "group", aria: { label: "Download" } });
  host.append(el("div", { class: "menu-host" }, button, menu));
  const open = popup(button, menu, () => draw());
  document.addEventListener("pointerdown", (event) => {
    if (!menu.hidden && event.target instanceof Node && !menu.contains(event.target) && event.target !== button) open(false);
  });

  function draw(): void {
    const shown = actions.shown();
    if (!shown) return fill(menu, el("p", { class: "hint", textContent: "There is nothing to download: the view shows no drive." }));
    const inBox = el("input", { type: "checkbox" });
    const links = el("div", { class: "download-links" });
    const drawLinks = () => {
      const box = inBox.checked && shown.box ? shown.box.map((v) => v.toFixed(2)).join(",") : null;
      const values = { valid_at: shown.at.valid, known_at: shown.at.known };
      fill(links,
        ...FORMATS.map(([format, name, bytes]) => link(name, api.download(shown.map, format, { ...values, box }), box ? "" : size(shown.coneCount * bytes))),
        ...(shown.since ? FORMATS.slice(0, 2).map(([format, name]) => link(`Changes, ${name}`, api.download(shown.map, format, { ...values, from_valid_at: shown.since }), "")) : []),
      ); // prettier-ignore
    };
    inBox.addEventListener("change", drawLinks);
    drawLinks();
    fill(menu,
      el("p", {}, el("strong", { textContent: shown.map }), ` ${shown.title}`), el("p", { class: "hint", textContent: `${countOf(shown.coneCount)} on the road; filters do not apply` }),
      shown.box && el("label", { class: "check" }, inBox, "Only the area in view"), links,
      feedForm(shown),
      el("button", { type: "button", class: "download-link", onclick: () => void picture(shown) }, "Image of the view", el("small", { textContent: "PNG" })),
      shown.drive && shown.drive.frame_pair_count > 0 && report(shown.map, shown.drive)); // prettier-ignore
  }

  const link = (name: string, href: string, detail: string) =>
    el("a", { class: "download-link", href, download: "" }, name, el("small", { textContent: detail }));
  const report = (map: string, drive: TimelineItem) =>
    el("a", { class: "download-link", href: api.report(map, drive.changeset_no), target: "_blank", rel: "noopener" }, `Report on ${drive.drive_id}`, el("small", { textContent: "HTML" }));

  /** A feed names its publisher and road, which the map does not contain. */
  function feedForm(shown: Shown): HTMLElement {
    const [publisher, road] = (localStorage.getItem(REMEMBERED) ?? "\n").split("\n");
    const field = (label: string, value: string | undefined) => el("input", { type: "text", required: true, maxLength: 200, value: value ?? "", placeholder: label, aria: { label } });
    const [who, where] = [field("Publisher", publisher), field("Road name", road)];
    const form = el("form", {}, who, where, el("button", { type: "submit", textContent: "Download WZDx" }));
    form.addEventListener("submit", (event) => {
      event.preventDefault();
      localStorage.setItem(REMEMBERED, `${who.value}\n${where.value}`);
      void save(api.download(shown.map, "wzdx", { valid_at: shown.at.valid, publisher: who.value, road_name: where.value }));
    });
    return el("details", {}, el("summary", { class: "download-link" }, "Work zones, WZDx 4.2"), form);
  }

  /** A small file, fetched here so that an error can be shown. */
  async function save(path: string): Promise<void> {
    try {
      const response = await fetch(path);
      if (!response.ok) throw new ApiError(detailOf(await response.json()) ?? "", response.status);
      const name = /filename="([^"]+)"/.exec(response.headers.get("content-disposition") ?? "")?.[1] ?? "wzdx.geojson";
      saveBlob(await response.blob(), name);
    } catch (error) {
      actions.failed(`The file could not be created: ${messageOf(error)}`);
    }
  }

  async function picture(shown: Shown): Promise<void> {
    try {
      saveBlob(await actions.picture(), `${shown.map}_${stamp(shown.at.valid ?? new Date().toISOString())}.png`);
    } catch (error) {
      actions.failed(`The image could not be created: ${messageOf(error)}`);
    }
  }
}

/** As the server names its files: 2026-03-02T09-41-07Z. */
const stamp = (iso: string) => `${utc(iso).replace(" ", "T").replaceAll(":", "-")}Z`;

const size = (bytes: number) => (bytes >= 1e6 ? `about ${Math.round(bytes / 1e6)} MB` : `about ${Math.max(1, Math.round(bytes / 1e3))} kB`);

function saveBlob(blob: Blob, name: string): void {
  const url = URL.createObjectURL(blob);
  el("a", { href: url, download: name }).click();
  window.setTimeout(() => URL.revokeObjectURL(url), 10_000);
}

/** The canvas with the scale and a line that says what it shows. Call it in the frame in which the canvas was drawn. */
export function pictureOf(canvas: HTMLCanvasElement, view: HTMLElement, title: string): Promise<Blob> {
  const ratio = canvas.width / Math.max(canvas.clientWidth, 1);
  const out = el("canvas", { width: canvas.width, height: canvas.height + Math.round(30 * ratio) });
  const pen = out.getContext("2d");
  if (!pen) throw new Error("this browser has no 2D canvas");
  pen.fillStyle = "#ffffff";
  pen.fillRect(0, 0, out.width, out.height);
  pen.drawImage(canvas, 0, 0);
  pen.scale(ratio, ratio);
  pen.font = "13px system-ui, sans-serif";
  pen.fillStyle = "#1d2733";
  pen.textBaseline = "middle";
  const bottom = canvas.clientHeight + 15;
  pen.fillText(title, 10, bottom, canvas.clientWidth - 200);
  const bar = view.querySelector<HTMLElement>(".scalebar i");
  const text = view.querySelector<HTMLElement>(".scalebar span")?.textContent ?? "";
  const width = bar?.offsetWidth ?? 0;
  pen.textAlign = "right";
  pen.fillText(text, canvas.clientWidth - 10, bottom);
  if (width) pen.fillRect(canvas.clientWidth - 22 - pen.measureText(text).width - width, bottom - 1.5, width, 3);
  return new Promise((done, fail) => out.toBlob((blob) => (blob ? done(blob) : fail(new Error("the image is too large"))), "image/png"));
}
