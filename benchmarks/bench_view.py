"""How long the web view takes to its first picture, and what a large point cloud costs: headless Chromium with software WebGL.

A private cluster in a temporary folder gets two drives past `--cones` cones, `--lines` lane boundaries and `--points` LiDAR
points, all along one road. For each run a fresh browser opens the page; the first picture is there when all cones, all lines and
points are drawn. Processor time is that of Chromium's processes up to then, the wall clock depends on what else the machine does
(load average is printed). Then the page is asked how many points it draws at most, how long a click takes to find a cone, and how
long pictures take while the camera turns.

    python benchmarks/bench_view.py [--points 100000] [--cones 500] [--lines 200] [--runs 3] [--pictures folder]
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import time
import urllib.request
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any
from uuid import uuid4

import laspy
import numpy as np
from playwright.sync_api import sync_playwright
from pyproj import CRS

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks.made_up_map import DAY_NS, MAP_NAME, SPACING_M, SRID, drive_along, place_of
from conetl.db.cluster.cluster import cluster_remove, cluster_up
from conetl.db.connection import connect
from conetl.db.map.commit import commit_changeset
from conetl.db.map.map_store import map_transaction
from conetl.db.schema import migrate
from conetl.model.map_records import Changeset, Delta, DeltaKind, MapFeature
from conetl.model.records import DriveRecords

ROOT = Path(__file__).resolve().parents[1]
FLAGS = [
    "--no-sandbox", "--disable-quic", "--no-first-run", "--disable-background-networking", "--disable-component-update",
    "--disable-sync", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader",
]  # fmt: skip
#: Run in the page before its own script: what came when, in milliseconds since the page was asked for.
WATCH = """
window.marks = {};
const watch = () => {
  const root = document.documentElement, canvas = document.querySelector('canvas');
  const is = { cones: Number(root.dataset.cones) > 0, lines: Number(root.dataset.lines) > 0,
               frame: Number(canvas?.dataset.frames) > 0, points: Number(canvas?.dataset.points) > 0 };
  for (const [name, there] of Object.entries(is)) if (there) window.marks[name] ??= performance.now();
  if (Object.values(is).every(Boolean)) root.dataset.firstPicture ??= 'there';
};
new MutationObserver(watch).observe(document, { subtree: true, attributes: true, childList: true });
"""


def processor_s(root: int) -> float:
    """Processor time of all processes below `root` whose name says Chromium, the ended ones that were waited for included."""
    parents: dict[int, int] = {}
    used: dict[int, float] = {}
    for path in Path("/proc").glob("[0-9]*/stat"):
        try:
            text = path.read_text()
        except OSError:
            continue
        name, fields = text[text.index("(") + 1 : text.rindex(")")], text[text.rindex(")") + 2 :].split()
        pid = int(path.parent.name)
        parents[pid] = int(fields[1])
        if "chrom" in name:
            used[pid] = sum(map(int, fields[11:15])) / os.sysconf("SC_CLK_TCK")

    def below(pid: int) -> bool:
        while pid in parents:
            if pid == root:
                return True
            pid = parents[pid]
        return False

    return sum(seconds for pid, seconds in used.items() if below(pid))


def two_days(conn: Any, count: int) -> None:
    """Day 1 finds `count` cones; of these day 2 confirms most, finds every twentieth 1.5 m farther and every twentieth gone."""
    old: list[MapFeature] = []
    for day in (1, 2):
        made = drive_along(0, int(count * 1.2), seed=1, days=day)
        tracks = made.tracks[:count]
        deltas = []
        for k, track in enumerate(tracks):
            where = {"track_index": k, "changed_at_ns": track.first_seen_ns + (day - 1) * DAY_NS // 100}
            if day == 1:
                shared = {name: getattr(track, name) for name in MapFeature.model_fields if hasattr(track, name)}
                feature = MapFeature(feature_id=uuid4(), version=1, **shared)
                old.append(feature)
                deltas.append(
                    Delta(
                        kind=DeltaKind.ADDED,
                        feature_id=feature.feature_id,
                        old=None,
                        new=feature,
                        shift_m=None,
                        **where,
                    )
                )
                continue
            feature = old[k]
            if k % 20 == 19:
                where["track_index"] = None
                deltas.append(
                    Delta(
                        kind=DeltaKind.REMOVED,
                        feature_id=feature.feature_id,
                        old=feature,
                        new=None,
                        shift_m=None,
                        **where,
                    )
                )
                continue
            east_m = 1.5 if k % 20 == 9 else 0.0
            xyz_m = (feature.xyz_m[0] + east_m, *feature.xyz_m[1:])
            new = feature.model_copy(update={"version": 2, "xyz_m": xyz_m, "observation_count": 2})
            kind = DeltaKind.MOVED if east_m else DeltaKind.CONFIRMED
            deltas.append(
                Delta(kind=kind, feature_id=feature.feature_id, old=feature, new=new, shift_m=east_m, **where)
            )
        key = hashlib.sha256(made.drive.drive_id.encode()).hexdigest()
        changeset = Changeset(
            changeset_id=uuid4(), drive_id=made.drive.drive_id, idempotency_key=key, params_sha256="0" * 64,
            model_sha256="0" * 64, code_version="bench", deltas=tuple(deltas),
        )  # fmt: skip
        with map_transaction(conn, MAP_NAME):
            commit_changeset(
                conn, DriveRecords(made.drive, [], [], made.positions, made.tracks), changeset, map_name=MAP_NAME
            )


def make_layers(folder: Path, points: int, lines: int, cones: int) -> list[Path]:
    """A road of LiDAR points, and lane boundaries beside each other along it."""
    rng = np.random.default_rng(1)
    along = np.arange(cones)
    road = place_of(along)
    at = rng.uniform(0, (cones - 1) * SPACING_M, points)
    header = laspy.LasHeader(point_format=6, version="1.4")
    header.scales, header.offsets = [0.001] * 3, [400_000.0, 5_400_000.0, 100.0]
    header.add_crs(CRS.from_epsg(SRID))
    las = laspy.LasData(header)
    las.x = road[0, 0] + at
    las.y = np.interp(at, along * SPACING_M, road[:, 1]) + rng.uniform(-12, 12, points)
    las.z = 100 + rng.normal(0, 0.02, points) + (rng.random(points) < 0.15) * rng.uniform(0, 6, points)
    las.intensity = rng.integers(0, 255, points)
    las.write(folder / "street.laz")
    piece = max(cones * 8 // lines, 2)
    features = []
    for i in range(lines):
        part = road[(i // 8) * piece : (i // 8 + 1) * piece + 1]
        if len(part) > 1:
            xyz = np.add(part, (0, 1.75 * (i % 8 - 4), 0)).round(3).tolist()
            properties = {"kind": "line_thin", "subtype": "dashed" if i % 3 else "solid"}
            features.append(
                {"type": "Feature", "properties": properties, "geometry": {"type": "LineString", "coordinates": xyz}}
            )
    crs = {"type": "name", "properties": {"name": f"urn:ogc:def:crs:EPSG::{SRID}"}}
    (folder / "lanes.geojson").write_text(json.dumps({"type": "FeatureCollection", "crs": crs, "features": features}))
    return [folder / "street.laz", folder / "lanes.geojson"]


@contextmanager
def view(home: Path, environment: dict[str, str]) -> Any:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    command = [sys.executable, "-c", "from conetl.cli import main; main()", "view", "--port", str(port), "--decisions"]
    with subprocess.Popen(command, env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as server:
        address = f"http://127.0.0.1:{port}/"
        try:
            for _ in range(600):
                try:
                    urllib.request.urlopen(address, timeout=1).close()
                    break
                except OSError:
                    time.sleep(0.2)
            yield address
        finally:
            server.send_signal(signal.SIGINT)


def first_picture(playwright: Any, address: str, picture: Path | None, *, close: bool = True) -> Any:
    browser = playwright.chromium.launch(executable_path=shutil.which("chromium"), args=FLAGS)
    tab = browser.new_page(viewport={"width": 1280, "height": 800})
    tab.add_init_script(WATCH)
    tab.goto("about:blank")
    start_s = processor_s(os.getpid())
    tab.goto(address, wait_until="commit")
    tab.wait_for_selector("html[data-first-picture]", state="attached", timeout=120_000)
    used_s = processor_s(os.getpid()) - start_s
    marks = tab.evaluate("window.marks")
    entries = tab.evaluate(
        "performance.getEntriesByType('resource').map(e => [e.name.replace(location.origin, ''), e.startTime, e.responseStart,"
        " e.responseEnd, e.encodedBodySize])"
    )
    if picture:
        tab.screenshot(path=picture)
    if close:
        browser.close()
    return marks, used_s, entries, browser, tab


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--points", type=int, default=100_000)
    parser.add_argument("--cones", type=int, default=500)
    parser.add_argument("--lines", type=int, default=200)
    parser.add_argument("--runs", type=int, default=3)
    parser.add_argument("--pictures", type=Path)
    parser.add_argument("--requests", action="store_true", help="list the page's requests")
    options = parser.parse_args()
    folder = Path(tempfile.mkdtemp(prefix="conetl-bench-view-"))
    home = folder / "home"
    try:
        url = cluster_up(home)
        with closing(connect(url)) as conn:
            migrate(conn)
            two_days(conn, options.cones)
        environment = {
            **os.environ, "CONETL_DATABASE_URL": url, "CONETL_MAP_NAME": MAP_NAME, "CONETL_HOME": str(home),
            "PYTHONPATH": f"{ROOT / 'src'}:{ROOT}",
        }  # fmt: skip
        files = [str(f) for f in make_layers(folder, options.points, options.lines, options.cones)]
        command = [sys.executable, "-c", "from conetl.cli import main; main()", "base", "import", *files]
        subprocess.run(command, env=environment, check=True)
        with view(home, environment) as address, sync_playwright() as playwright:
            measure(playwright, address, options)
    finally:
        cluster_remove(home)
        shutil.rmtree(folder)


def measure(playwright: Any, address: str, options: argparse.Namespace) -> None:
    for run in range(options.runs):
        marks, used_s, entries, browser, tab = first_picture(playwright, address, None, close=False)
        parts = ", ".join(f"{name} {ms / 1000:.2f}" for name, ms in sorted(marks.items(), key=lambda m: m[1]))
        print(
            f"first picture {max(marks.values()) / 1000:.2f} s ({parts}); Chromium's processor time "
            f"{used_s:.1f} s; load {os.getloadavg()[0]:.1f}"
        )
        if options.requests and run == options.runs - 1:
            for name, start, begin, end, size in entries:
                print(f"  {start:7.0f} {begin:7.0f} {end:7.0f} ms {size:9d} bytes  {name[:80]}")
        if run == options.runs - 1:
            use(tab, options.pictures)
        browser.close()


def use(tab: Any, pictures: Path | None) -> None:
    """Points drawn, clicks, and pictures while turning."""
    tab.wait_for_selector("canvas[data-loading='0']", timeout=120_000)
    tab.wait_for_timeout(1500)
    if pictures:
        pictures.mkdir(parents=True, exist_ok=True)
        tab.screenshot(path=pictures / "start.png")
    for _ in range(5):
        tab.keyboard.press("+")
    tab.wait_for_timeout(1500)
    tab.wait_for_selector("canvas[data-loading='0']", timeout=120_000)
    tab.wait_for_timeout(1500)
    most = int(tab.get_attribute("canvas", "data-points"))
    times = tab.evaluate(
        "() => { const out = []; for (let i = 0; i < 60; i++) out.push(window.conetlPickTime(13 * i, 300 + 3 * i)); return out; }"
    )
    start_frames = int(tab.get_attribute("canvas", "data-frames"))
    started = time.monotonic()
    for _ in range(20):
        tab.keyboard.press("Shift+ArrowLeft")
        tab.evaluate("() => new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))")
        most = max(most, int(tab.get_attribute("canvas", "data-points")))
    frames = int(tab.get_attribute("canvas", "data-frames")) - start_frames
    each_ms = 1000 * (time.monotonic() - started) / max(frames, 1)
    print(
        f"points drawn at most {most:,}; finding the cone under a click: median {np.median(times):.2f} ms, "
        f"worst {max(times):.2f} ms; "
        f"while turning {each_ms:.0f} ms a picture ({frames} pictures)"
    )
    if pictures:
        tab.screenshot(path=pictures / "near.png")


if __name__ == "__main__":
    main()
