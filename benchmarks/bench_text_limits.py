"""Every reader of text on a large file of its kind: processor time and peak memory.

    .venv/bin/python -m benchmarks.bench_text_limits [--only TEXT] [--scale 0.1]

Each file is read in a process of its own. The times of a busy machine are longer: `loop_s` is that of a million steps before
each file, about 0.05 s on an idle processor of 2024.
"""

from __future__ import annotations

import resource
import tempfile
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from benchmarks.harness import arguments_of, print_rows, write_json
from conetl.files import documents
from conetl.files.documents import MAX_JSON_BYTES, MAX_TABLE_LINES, MAX_YAML_BYTES, read_table_bytes, table_lines
from conetl.model.params import ImportParams
from conetl.readers.base_layers.line_files import read_vector_file
from conetl.readers.base_layers.lines import read_lanelet2
from conetl.readers.base_layers.opendrive import read_opendrive
from conetl.readers.drives.drive_yaml import read_drive_yaml
from conetl.readers.drives.plain import Row, Rows
from conetl.readers.maps.imported_rows import read_map_file
from conetl.readers.maps.tables import MAX_ROWS
from conetl.readers.plans import read_plans
from conetl.readers.rigs import read_rig
from conetl.readers.surveyed_points import MOST_POINTS, read_surveyed_points
from conetl.readers.trajectories import read_trajectory
from conetl.readers.trajectories.times import parse_timestamps
from tests.unit.readers import trajectory_files as logs

#: A log of a working day at 10 Hz; logs may have a hundred times as many (20 million records, 2 GiB).
LOG_RECORDS = 300_000
#: A register of a large city, the most that one file may have.
MAP_ROWS = MAX_ROWS


class Case(NamedTuple):
    """A kind of file."""

    records: int
    write: Callable[[Path, int], Path]
    """Writes so many records into a folder."""
    read: Callable[[Path], object]


def written(name: str, lines: Callable[[int], Iterator[str]]) -> Callable[[Path, int], Path]:
    def write(folder: Path, count: int) -> Path:
        path = folder / name
        with path.open("w", encoding="utf-8") as file:
            file.writelines(f"{line}\n" for line in lines(count))
        return path

    return write


def osm_lines(count: int) -> Iterator[str]:
    yield '<?xml version="1.0" encoding="UTF-8"?>\n<osm version="0.6">'
    for k in range(count):
        lat, lon = 49 + 1e-6 * (k % 997), 8 + 1e-7 * k
        yield f'  <node id="{k}" lat="{lat:.11f}" lon="{lon:.11f}"><tag k="ele" v="{k % 90:.4f}"/></node>'
    for way in range(count // 20):
        references = "".join(f'<nd ref="{20 * way + k}"/>' for k in range(20))
        yield f'  <way id="{way}">{references}<tag k="type" v="line_thin"/><tag k="subtype" v="dashed"/></way>'
    yield "</osm>"


def opendrive_lines(count: int) -> Iterator[str]:
    """Roads of 120 m in two sections with seven lane borders."""
    yield "<OpenDRIVE><header><geoReference>+proj=utm +zone=32 +datum=WGS84</geoReference></header>"

    def lane(number: int) -> str:
        zero = "0.0000000000000000e+00"
        return (
            f'<lane id="{number}" type="driving" level="false"><link><predecessor id="{number}"/></link>'
            f'<width sOffset="{zero}" a="3.5000000000000000e+00" b="{zero}" c="{zero}" d="{zero}"/>'
            f'<roadMark sOffset="{zero}" type="broken" weight="standard" color="standard" width="0.12"/></lane>'
        )

    shapes = ("<line/>", '<arc curvature="0.001"/>')
    for road in range(count):
        pieces = "".join(
            f'<geometry s="{30 * k}" x="{500_000 + 30 * k}" y="{5_400_000 + 40 * road}" hdg="0" length="30">'
            f"{shapes[k % 2]}</geometry>"
            for k in range(4)
        )
        sections = "".join(
            f'<laneSection s="{start}"><left>{"".join(map(lane, (3, 2, 1)))}</left><center><lane id="0"/></center>'
            f"<right>{''.join(map(lane, (-1, -2, -3)))}</right></laneSection>"
            for start in (0, 60)
        )
        yield (
            f'<road id="{road}" length="120"><planView>{pieces}</planView><elevationProfile><elevation s="0" a="100" b="0" c="0" '
            f'd="0"/></elevationProfile><lanes>{sections}</lanes></road>'
        )
    yield "</OpenDRIVE>"


def short_roads(count: int) -> Iterator[str]:
    """Roads of one straight piece without lanes, as connections within junctions are."""
    yield "<OpenDRIVE><header><geoReference>+proj=utm +zone=32 +datum=WGS84</geoReference></header>"
    for k in range(count):
        piece = f'<geometry s="0" x="{500_000 + k}" y="5400000" hdg="1" length="10"/>'
        yield f'<road id="{k}" length="10"><planView>{piece}</planView></road>'
    yield "</OpenDRIVE>"


def features(count: int, geometry: Callable[[int], str], properties: Callable[[int], str]) -> Iterator[str]:
    yield '{"type": "FeatureCollection", "features": ['
    for k in range(count):
        comma = "," if k + 1 < count else ""
        yield f'{{"type":"Feature","properties":{{{properties(k)}}},"geometry":{geometry(k)}}}{comma}'
    yield "]}"


def line_features(count: int) -> Iterator[str]:
    return features(
        count,
        lambda k: f'{{"type":"LineString","coordinates":[[{8 + 1e-6 * k:.7f},49.0],[{8 + 1e-6 * k:.7f},49.001]]}}',
        lambda k: '"kind":"solid"',
    )


def cone_features(count: int) -> Iterator[str]:
    return features(
        count,
        lambda k: (
            f'{{"type":"Point","coordinates":[{8 + 1.1e-7 * k:.8f},{49 + 1.1e-7 * (k % 977):.8f},{100 + k % 17:.3f}]}}'
        ),
        lambda k: '"category":"traffic_cone","sigma_e_m":0.02,"sigma_n_m":0.02,"sigma_u_m":0.04',
    )


def cone_rows(count: int) -> Iterator[str]:
    yield "name,easting_m,northing_m,ground_height_m,sigma_e_m,sigma_n_m,sigma_u_m,last_seen_at"
    for k in range(count):
        east, north = 458_000 + k % 9973 * 1.07, 5_428_000 + k / 31
        yield f"p{k},{east:.4f},{north:.4f},{100 + k % 17:.4f},0.02,0.02,0.04,2026-03-02T10:00:00Z"


def times_file(count: int) -> Iterator[str]:
    return (f"2026-03-02 10:{k // 60_000 % 60:02d}:{k // 1000 % 60:02d}.{k % 1000:03d}000000" for k in range(count))


def plain_rows(count: int) -> Iterator[str]:
    yield ",".join(Row.model_fields)
    for k in range(count):
        yield f"{k},2026-03-02 10:00:00.{k:06d},{8 + 1e-6 * k:.8f},49,116,0.1,0.2,{k % 180},0.02,0.02,0.03,0.1,0.1,0.1"


def wzdx_lines(count: int) -> Iterator[str]:
    yield '{"feed_info": {"publisher": "x", "version": "4.2"}, "type": "FeatureCollection", "features": ['
    for k in range(count):
        yield (
            f'{{"id":"{k}","type":"Feature","properties":{{"core_details":{{"event_type":"work-zone","road_names":["A5"],"direction":'
            f'"northbound"}},"start_date":"2026-03-02T10:00:00Z","end_date":"2026-03-09T10:00:00Z"}},"geometry":{{"type":"LineString",'
            f'"coordinates":[[8.1,49],[8.2,49]]}}}}{"," if k + 1 < count else ""}'
        )
    yield "]}"


def permit_rows(count: int) -> Iterator[str]:
    yield "permit_id,start,end,lon,lat"
    yield from (f"P{k},2026-03-02T10:00:00Z,2026-03-09T10:00:00Z,{8 + 1e-5 * k:.6f},49.0" for k in range(count))


def keys(count: int) -> Iterator[str]:
    return (f"key{k:07d}: 1" for k in range(count))


def json_keys(count: int) -> Iterator[str]:
    yield from ("{", *(f'"key{k:07d}": 1.0,' for k in range(count)), '"a": 1}')


def kitti_lines(count: int) -> Iterator[str]:
    return (f"P_{k:07d}: 721.5 0 609.5 44.8 0 721 1" for k in range(count))


def read_cones(path: Path) -> object:
    if path.suffix == ".csv":
        return read_map_file(path, ImportParams(), crs="EPSG:25832")
    return read_map_file(path, ImportParams(), map_srid=25832, stated_at=logs.START)


def log(write: Callable[..., Path]) -> Callable[[Path, int], Path]:
    def write_it(folder: Path, count: int) -> Path:
        k, known = np.arange(count, dtype=np.float64), logs.known(count)
        llh = np.column_stack([49.0 + 1e-3 * np.cos(k / 3000), 8.43 + 1e-3 * np.sin(k / 3000), 116 + np.sin(k / 1000)])
        return write(folder, known._replace(llh=llh, sigma=np.tile(known.sigma[0], (count, 1))))

    return write_it


CASES: dict[str, Case] = {
    **{
        f"log: {name}": Case(LOG_RECORDS, log(write), read_trajectory)
        for name, write in (
            ("rtklib", logs.write_rtklib), ("inertial_explorer", logs.write_inertial_explorer), ("nmea", logs.write_nmea),
            ("gpx", logs.write_gpx), ("tum", logs.write_tum), ("euroc", logs.write_euroc), ("csv", logs.write_csv),
            ("pospac", logs.write_pospac),
        )
    },
    "times file": Case(
        MAX_TABLE_LINES, written("timestamps.txt", times_file), lambda path: parse_timestamps(table_lines(read_table_bytes(path)))
    ),
    "plain: trajectory.csv": Case(
        documents.MAX_LINES_WITHOUT_IMAGE - 1, written("trajectory.csv", plain_rows),
        lambda path: Rows(path).add(table_lines(read_table_bytes(path, 0))),
    ),
    "drive.yaml": Case(MAX_YAML_BYTES // 14, written("drive.yaml", keys), lambda path: read_drive_yaml(path.parent)),
    "rig: yaml": Case(MAX_YAML_BYTES // 14, written("rig.yaml", keys), read_rig),
    "rig: json": Case(MAX_JSON_BYTES // 20, written("rig.json", json_keys), read_rig),
    "rig: text": Case(MAX_JSON_BYTES // 45, written("calib.txt", kitti_lines), read_rig),
    "map: csv": Case(MAP_ROWS, written("cones.csv", cone_rows), read_cones),
    "map: geojson": Case(MAP_ROWS, written("cones.geojson", cone_features), read_cones),
    "check points: csv": Case(
        MOST_POINTS, written("points.csv", cone_rows), lambda path: read_surveyed_points(path, 25832, crs="EPSG:25832")
    ),
    "plans: wzdx": Case(MAX_JSON_BYTES // 320, written("feed.json", wzdx_lines), read_plans),
    "plans: permits": Case(50_000, written("permits.csv", permit_rows), read_plans),
    "base: osm nodes": Case(1_000_000, written("lanes.osm", osm_lines), read_lanelet2),
    "base: opendrive roads": Case(4_000, written("lanes.xodr", opendrive_lines), read_opendrive),
    "base: opendrive short roads": Case(20_000, written("lanes.xodr", short_roads), read_opendrive),
    "base: geojson lines": Case(200_000, written("lanes.geojson", line_features), read_vector_file),
}  # fmt: skip


def main() -> None:
    parser = arguments_of(__doc__)
    parser.add_argument("--only", default="", help="cases with this in their names")
    parser.add_argument("--scale", type=float, default=1.0, help="so many times the records")
    options = parser.parse_args()
    rows = [row(name, case, options.scale) for name, case in CASES.items() if options.only in name]
    print_rows("Large text files", rows)
    write_json(options.json, rows)


def row(name: str, case: Case, scale: float) -> dict[str, Any]:
    with tempfile.TemporaryDirectory() as folder:
        count = max(1, round(scale * case.records))
        path = case.write(Path(folder), count)
        with ProcessPoolExecutor(1, mp_context=get_context("fork")) as pool:
            found = pool.submit(measured, name, path).result()
        return {"file": name, "records": count, "MB": path.stat().st_size / 1e6, **found}


def measured(name: str, path: Path) -> dict[str, Any]:
    start = time.process_time()
    for _ in range(1_000_000):
        pass
    loop_s = time.process_time() - start
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    start = time.process_time()
    try:
        CASES[name].read(path)
        result = "read"
    except Exception as error:
        result = str(error).partition(": ")[2][:60]
    took_s = time.process_time() - start
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before
    return {"processor_s": took_s, "loop_s": loop_s, "peak_mb": peak / 1024, "result": result}


if __name__ == "__main__":
    main()
