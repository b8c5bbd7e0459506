"""Time of the web view to its first image, and cost of a large point cloud: headless Chromium with software WebGL.

A private cluster in a temporary folder gets two drives past `--cones` cones, `--lines` lane boundaries and `--points` LiDAR
points, along parallel streets of a town. Each run opens the page in a new browser; the first image is complete when all cones,
all lines and points are drawn. Processor time is that of Chromium's processes until then. Then the number of drawn points, the
time to find the cone under a click, and frames while the camera pans and zooms are measured, the latter in several views. The
list of another map with `--rows` cones is scrolled from its top to its end. Maps of `--sizes` features are opened last: time to
the first image with cones or clusters, of tiles, and of the lists' requests.

    python benchmarks/bench_view.py [--points 100000] [--cones 500] [--lines 200] [--runs 3] [--rows 2000] [--sizes 60000 1000000]
        [--seconds 6]
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import subprocess
import time
import urllib.request
from contextlib import closing
from pathlib import Path
from typing import Any
from uuid import uuid4

import laspy
import numpy as np
from playwright.sync_api import sync_playwright
from pyproj import CRS

from benchmarks.harness import CONETL, arguments_of, load, own_cluster, processor_s, served_view, write_json
from benchmarks.made_up_maps import DAY_NS, MAP_NAME, SPACING_M, SRID, WEST_M, drive_along, load_roads, position_of
from conetl.db.connection import connect
from conetl.db.map.map_store import map_transaction
from conetl.model.base import Vec3
from conetl.model.drive import Drive, DriveRecords, Position, Track
from conetl.model.map_records import Changeset, Delta, DeltaKind, MapFeature
from tests.chromium import CHROMIUM, FLAGS
from tests.records import write

#: Name of the map with the long list.
MANY = "many"
#: Run in the page before its own script: when each part was there, in milliseconds since the request.
WATCH = """
window.marks = {};
const watch = () => {
  const root = document.documentElement, canvas = document.querySelector('canvas');
  const is = { cones: Number(root.dataset.cones) + Number(root.dataset.clustered) > 0, lines: Number(root.dataset.lines) > 0,
               frame: Number(canvas?.dataset.frames) > 0, points: Number(canvas?.dataset.points) > 0 };
  for (const [name, there] of Object.entries(is)) if (there) window.marks[name] ??= performance.now();
  if (Object.values(is).every(Boolean)) root.dataset.firstImage ??= 'complete';
};
new MutationObserver(watch).observe(document, { subtree: true, attributes: true, childList: true });
"""


#: Scrolls a table to its end: frames, milliseconds, frames that showed a gap where a row should be; and frames per second while
#: one cell changes, which is what the machine can paint of this page at all.
SCROLL = """async () => {
  const table = document.querySelector('#list-cones .table'), space = table.querySelector('.table-space');
  const end = space.offsetHeight - table.clientHeight, steps = 300;
  let gaps = 0;
  const frame = () => new Promise((done) => requestAnimationFrame(done));
  await frame();
  const start = performance.now();
  for (let i = 1; i <= steps; i++) {
    table.scrollTop = (end * i) / steps;
    await frame();
    await frame();
    const middle = Math.floor((table.scrollTop + table.clientHeight / 2) / 26);
    if (!space.querySelector(`[data-index="${middle}"]`)) gaps += 1;
  }
  const ms = performance.now() - start, cell = space.querySelector('.cell'), again = performance.now();
  for (let i = 0; i < steps; i++) {
    cell.textContent = String(i);
    await frame();
  }
  return { frames: 2 * steps, ms, gaps, cellPerS: 1000 * steps / (performance.now() - again) };
}"""


#: Pans and zooms by a key in every frame: frames, and milliseconds.
PAN = """async (seconds) => {
  const canvas = document.querySelector('canvas'), first = Number(canvas.dataset.frames), start = performance.now();
  for (let i = 0; performance.now() - start < 1000 * seconds; i++) {
    const key = ['ArrowLeft', '+', 'ArrowRight', '-'][Math.floor(i / 8) % 4];
    canvas.dispatchEvent(new KeyboardEvent('keydown', { key, bubbles: true }));
    await new Promise((done) => requestAnimationFrame(done));
  }
  return [Number(canvas.dataset.frames) - first, performance.now() - start];
}"""
#: Parts of the address.
VIEWS = {
    "usual": "",
    "plan": "view=plan",
    "light by depth": "shading=1",
    "side by side": "mode=compare&from=1&swipe=split",
}
STREET_M, STREETS_APART_M = 600.0, 30.0

#: Requests of lists and of what is selected.
LISTS = {
    "first page": "features?sort=existence",
    "sorted": "features?sort=north-",
    "at row 50,000": "features?sort=north-&offset=50000",
    "filtered, counted": "features/count?least_existence=0.5",
    "search": "search?text=00f",
    "changes of a drive": "changes?changeset_no=2&sort=shift-",
    "changes in view": "changes/view?changeset_no=2&area=420000&area=5400000&area=421000&area=5400000&area=421000&area=5401000",
}


def in_town(xyz_m: np.ndarray) -> np.ndarray:
    """Positions (..., 3) along one road -> along streets of STREET_M side by side."""
    along_m = xyz_m[..., 0] - WEST_M
    street = np.floor(along_m / STREET_M)
    shift_m = np.stack([-street * STREET_M, street * STREETS_APART_M, 0 * street], axis=-1)
    return np.asarray(xyz_m + shift_m)


def through_town(count: int, days: int) -> tuple[Drive, list[Position], list[Track]]:
    """`drive_along` past cones in the streets."""
    made = drive_along(0, int(count * 1.2), seed=1, days=days)

    def place(xyz_m: Vec3) -> Vec3:
        east, north, up = in_town(np.array(xyz_m)).tolist()
        return east, north, up

    def moved(one: Any) -> Any:
        return one.model_copy(update={"xyz_m": place(one.xyz_m), "centre_xyz_m": place(one.centre_xyz_m)})

    pairs = [
        pair.model_copy(update={"pose": pair.pose.model_copy(update={"map_t_body_m": place(pair.pose.map_t_body_m)})})
        for pair in made.drive.frame_pairs
    ]
    drive = made.drive.model_copy(update={"frame_pairs": tuple(pairs)})
    return drive, [moved(one) for one in made.positions], [moved(one) for one in made.tracks]


def two_days(conn: Any, count: int, map_name: str = MAP_NAME) -> None:
    """Day 1 adds `count` cones; day 2 confirms most, moves every twentieth by 1.5 m and removes every twentieth."""
    old: list[MapFeature] = []
    for day in (1, 2):
        drive, positions, tracks = through_town(count, day)
        deltas = []
        for k, track in enumerate(tracks[:count]):
            changed_at_ns = track.first_seen_ns + (day - 1) * DAY_NS // 100
            if day == 1:
                shared = {name: getattr(track, name) for name in MapFeature.model_fields if hasattr(track, name)}
                old.append(MapFeature(feature_id=uuid4(), version=1, **shared))
                before, after, kind, shift_m = None, old[-1], DeltaKind.ADDED, None
            elif k % 20 == 19:
                before, after, kind, shift_m = old[k], None, DeltaKind.REMOVED, None
            else:
                before, shift_m = old[k], 1.5 if k % 20 == 9 else 0.0
                xyz_m = (before.xyz_m[0] + shift_m, *before.xyz_m[1:])
                after = before.model_copy(update={"version": 2, "xyz_m": xyz_m, "observation_count": 2})
                kind = DeltaKind.MOVED if shift_m else DeltaKind.CONFIRMED
            deltas.append(
                Delta(
                    kind=kind, feature_id=old[k].feature_id, old=before, new=after, shift_m=shift_m,
                    track_index=None if after is None else k, changed_at_ns=changed_at_ns,
                )
            )  # fmt: skip
        key = hashlib.sha256(drive.drive_id.encode()).hexdigest()
        changeset = Changeset(
            changeset_id=uuid4(), drive_id=drive.drive_id, idempotency_key=key, params_sha256="0" * 64,
            model_sha256="0" * 64, code_version="bench", deltas=tuple(deltas),
        )  # fmt: skip
        records = DriveRecords(drive, [], [], positions, tracks)
        with map_transaction(conn, map_name):
            write(conn, records, changeset, map_name=map_name)


def make_layers(folder: Path, points: int, lines: int, cones: int) -> list[Path]:
    """A LAZ file of LiDAR points on the streets, and a GeoJSON file of lane boundaries along them."""
    rng = np.random.default_rng(1)
    along = np.arange(cones)
    road = position_of(along)
    at = rng.uniform(0, (cones - 1) * SPACING_M, points)
    header = laspy.LasHeader(point_format=6, version="1.4")
    header.scales, header.offsets = [0.001] * 3, [400_000.0, 5_400_000.0, 100.0]
    header.add_crs(CRS.from_epsg(SRID))
    las = laspy.LasData(header)
    north_m = np.interp(at, along * SPACING_M, road[:, 1]) + rng.uniform(-12, 12, points)
    up_m = 100 + rng.normal(0, 0.02, points) + (rng.random(points) < 0.15) * rng.uniform(0, 6, points)
    las.x, las.y, las.z = in_town(np.column_stack([road[0, 0] + at, north_m, up_m])).T
    las.intensity = rng.integers(0, 255, points)
    las.write(folder / "street.laz")
    piece = max(cones * 8 // lines, 2)
    features = []
    for i in range(lines):
        part = road[(i // 8) * piece : (i // 8 + 1) * piece + 1]
        if len(part) > 1:
            same = np.floor((part[:, 0] - WEST_M) / STREET_M) == np.floor((part[0, 0] - WEST_M) / STREET_M)
            xyz = np.add(in_town(part[same]), (0, 1.75 * (i % 8 - 4), 0)).round(3).tolist()
            if len(xyz) < 2:
                continue
            properties = {"kind": "line_thin", "subtype": "dashed" if i % 3 else "solid"}
            features.append(
                {"type": "Feature", "properties": properties, "geometry": {"type": "LineString", "coordinates": xyz}}
            )
    crs = {"type": "name", "properties": {"name": f"urn:ogc:def:crs:EPSG::{SRID}"}}
    (folder / "lanes.geojson").write_text(json.dumps({"type": "FeatureCollection", "crs": crs, "features": features}))
    return [folder / "street.laz", folder / "lanes.geojson"]


def first_image(playwright: Any, address: str) -> tuple[dict[str, float], float, Any]:
    """When each part was drawn (ms), Chromium's processor time (s), and the page, in a new browser."""
    browser = playwright.chromium.launch(executable_path=CHROMIUM, args=FLAGS)
    tab = browser.new_page(viewport={"width": 1280, "height": 800})
    tab.add_init_script(WATCH)
    tab.goto("about:blank")
    start_s = processor_s(os.getpid(), name="chrom")
    tab.goto(address, wait_until="commit")
    tab.wait_for_selector("html[data-first-image]", state="attached", timeout=120_000)
    used_s = processor_s(os.getpid(), name="chrom") - start_s
    return tab.evaluate("window.marks"), used_s, tab


def main() -> None:
    parser = arguments_of(__doc__)
    parser.add_argument("--points", type=int, default=100_000)
    parser.add_argument("--cones", type=int, default=500)
    parser.add_argument("--lines", type=int, default=200)
    parser.add_argument("--rows", type=int, default=2_000)
    parser.add_argument("--sizes", type=int, nargs="*", default=[])
    parser.add_argument("--runs", type=int, default=3)
    parser.add_argument("--seconds", type=float, default=6, help="of panning, in each view")
    parser.add_argument("--images", type=Path)
    options = parser.parse_args()
    with own_cluster() as (home, url):
        with closing(connect(url)) as conn:
            two_days(conn, options.cones)
            if options.rows:
                two_days(conn, options.rows, MANY)
        environment = {"CONETL_DATABASE_URL": url, "CONETL_MAP_NAME": MAP_NAME, "CONETL_HOME": str(home)}
        files = [str(f) for f in make_layers(home, options.points, options.lines, options.cones)]
        subprocess.run([*CONETL, "base", "import", *files], env=os.environ | environment, check=True)
        with served_view(home, url, MAP_NAME, "--decisions") as (address, _), sync_playwright() as playwright:
            figures = measure(playwright, address, options)
            figures["pan"] = {view: pan(playwright, address, view, part, options) for view, part in VIEWS.items()}
            if options.rows:
                figures |= scroll(playwright, f"{address}/#map={MANY}&mode=instant&list=cones", options.images)
    with sync_playwright() as playwright:
        figures["sizes"] = [large(playwright, size) for size in options.sizes]
    write_json(options.json, figures)


def measure(playwright: Any, address: str, options: argparse.Namespace) -> dict[str, object]:
    runs = []
    for _ in range(options.runs):
        marks, used_s, tab = first_image(playwright, address)
        parts = ", ".join(f"{name} {ms / 1000:.2f}" for name, ms in sorted(marks.items(), key=lambda m: m[1]))
        first_s = max(marks.values()) / 1000
        print(f"first image {first_s:.2f} s ({parts}); Chromium's processor time {used_s:.1f} s; load {load()}")
        runs.append({"first_image_s": first_s, "chromium_s": used_s})
        if len(runs) == options.runs:
            figures = use(tab, options.images)
        tab.context.browser.close()
    return {"runs": runs, **figures}


def answer_s(url: str) -> float:
    """Time to the answer of a request: the shorter of two."""
    times = []
    for _ in range(2):
        started = time.monotonic()
        urllib.request.urlopen(url, timeout=60).read()
        times.append(time.monotonic() - started)
    return min(times)


def large(playwright: Any, size: int) -> dict[str, float]:
    """First image, slowest tile and lists of a map of `size` features."""
    with own_cluster() as (home, url):
        with closing(connect(url)) as conn:
            load_roads(conn, size)
        with served_view(home, url, MAP_NAME) as (address, _):
            slowest_s = 0.0
            for zoom in range(13):
                at = position_of(np.array([size // 2]))[0]
                x, y = (int(value // 2 ** (20 - zoom)) for value in at[:2])
                slowest_s = max(slowest_s, answer_s(f"{address}/api/maps/{MAP_NAME}/tiles/{zoom}/{x}/{y}"))
            lists = {name: answer_s(f"{address}/api/maps/{MAP_NAME}/{path}") for name, path in LISTS.items()}
            browser = playwright.chromium.launch(executable_path=CHROMIUM, args=FLAGS)
            tab = browser.new_page(viewport={"width": 1280, "height": 800})
            tab.add_init_script(WATCH)
            tab.goto(address, wait_until="commit")
            tab.wait_for_function("() => window.marks.cones && window.marks.frame", timeout=120_000)
            first_s = max(tab.evaluate("[window.marks.cones, window.marks.frame]")) / 1000
            browser.close()
    said = ", ".join(f"{name} {s:.2f}" for name, s in lists.items())
    print(
        f"{size:,} features: first image {first_s:.2f} s, slowest tile {slowest_s:.2f} s; lists (s): {said}; load {load()}"
    )
    return {"size": size, "first_image_s": first_s, "slowest_tile_s": slowest_s, **lists}


def use(tab: Any, folder: Path | None) -> dict[str, float]:
    """Number of points, time of clicks, and frames while turning."""
    tab.wait_for_selector("canvas[data-loading='0']", timeout=120_000)
    tab.wait_for_timeout(1500)
    if folder:
        folder.mkdir(parents=True, exist_ok=True)
        tab.screenshot(path=folder / "start.png")
    for _ in range(5):
        tab.keyboard.press("+")
    tab.wait_for_timeout(1500)
    tab.wait_for_selector("canvas[data-loading='0']", timeout=120_000)
    tab.wait_for_timeout(1500)
    most = int(tab.get_attribute("canvas", "data-points"))
    times = tab.evaluate("() => Array.from({ length: 60 }, (_, i) => window.conetlPickTime(13 * i, 300 + 3 * i))")
    print(
        f"at most {most:,} points drawn; the cone under a click: median {np.median(times):.2f} ms, worst {max(times):.2f} ms"
    )
    if folder:
        tab.screenshot(path=folder / "near.png")
    return {"points": most, "click_ms": float(np.median(times))}


def pan(playwright: Any, address: str, view: str, part: str, options: argparse.Namespace) -> dict[str, float]:
    """Frames per second, and per second of Chromium's processor time, while the camera moves 150 m from the town's middle."""
    length_m = options.cones * SPACING_M
    east_m, north_m = min(length_m, STREET_M) / 2, length_m / STREET_M * STREETS_APART_M / 2
    browser = playwright.chromium.launch(executable_path=CHROMIUM, args=FLAGS)
    tab = browser.new_page(viewport={"width": 1280, "height": 800})
    tab.goto(f"{address}/#map={MAP_NAME}&cam={east_m},{north_m},100,0.6,1,150&{part}")
    tab.wait_for_selector("html[data-cones][data-lines]", state="attached", timeout=120_000)
    tab.wait_for_selector("canvas[data-loading='0']", timeout=120_000)
    tab.wait_for_timeout(3000)
    tab.evaluate(PAN, options.seconds / 3)
    start_s = processor_s(os.getpid(), name="chrom")
    frames, ms = tab.evaluate(PAN, options.seconds)
    used_s = processor_s(os.getpid(), name="chrom") - start_s
    browser.close()
    print(
        f"pan and zoom, {view}: {1000 * frames / ms:.1f} frames/s, {frames / used_s:.1f} per processor second; load {load()}"
    )
    return {"frames_per_s": 1000 * frames / ms, "frames_per_processor_s": frames / used_s}


def scroll(playwright: Any, address: str, folder: Path | None) -> dict[str, float]:
    """Time to the list of a large map, and frames per second while it scrolls."""
    browser = playwright.chromium.launch(executable_path=CHROMIUM, args=FLAGS)
    tab = browser.new_page(viewport={"width": 1280, "height": 800})
    started = time.monotonic()
    tab.goto(address)
    tab.wait_for_selector("#list-cones .row[data-index='0']", timeout=300_000)
    there_s = time.monotonic() - started
    tab.wait_for_timeout(3000)
    rows = int(tab.get_attribute("#list-cones .table", "aria-rowcount")) - 1
    start_s = processor_s(os.getpid(), name="chrom")
    found = tab.evaluate(SCROLL)
    used_ms = 1000 * (processor_s(os.getpid(), name="chrom") - start_s) / (1.5 * found["frames"])
    per_s = 1000 * found["frames"] / found["ms"]
    print(
        f"list of {rows:,} cones: there after {there_s:.1f} s; scrolled through at {per_s:.0f} frames/s "
        f"(one changing cell: {found['cellPerS']:.0f}), "
        f"{used_ms:.1f} ms of Chromium's processor time per frame, "
        f"{found['gaps']} of {found['frames'] // 2} positions with a gap; load {load()}"
    )
    if folder:
        tab.screenshot(path=folder / "list.png")
    browser.close()
    return {
        "list_rows": rows, "list_s": there_s, "list_frames_per_s": per_s, "list_frame_cpu_ms": used_ms,
        "list_one_cell_frames_per_s": found["cellPerS"], "list_gaps": found["gaps"],
    }  # fmt: skip


if __name__ == "__main__":
    main()
