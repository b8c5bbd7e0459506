"""Text files of a drive that are larger than any recording's: refused before they are read. Sparse ones cost no disk."""

from __future__ import annotations

import json
import os
import shutil
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from conetl.evaluation.markings import read_truth_markings
from conetl.evaluation.truth import read_truth
from conetl.files.documents import MAX_LINES_WITHOUT_IMAGE, MAX_TABLE_LINES, read_table_bytes, table_lines
from conetl.model.errors import DriveFolderError, InputError
from conetl.readers.base_layers.line_files import LINE_READERS
from conetl.readers.drives import pose_rows, read_drive
from conetl.readers.drives.drive_yaml import DriveYaml
from conetl.readers.drives.header import read_header
from conetl.readers.drives.image_times import times_of
from conetl.readers.drives.pairs import ContentHash, Image, Source
from conetl.readers.maps.tables import read_table
from conetl.readers.plans import read_plans
from conetl.readers.plans.wzdx import MOST_POSITIONS, MOST_RECORDS
from conetl.readers.rigs import read_rig
from conetl.readers.rigs.content import read_content
from conetl.readers.surveyed_points import MOST_POINTS, read_surveyed_points
from conetl.readers.trajectories import read_trajectory
from conetl.readers.trajectories.text import MAX_TEXT_BYTES, line_blocks
from tests.folders import SAMPLE
from tests.unit.readers import drive_formats as formats
from tests.unit.readers import trajectory_files as files

GIGABYTE = 1 << 30
#: Files of a KITTI drive; the others cost single frame pairs.
FILES = (
    "image_02/timestamps.txt", "image_03/timestamps.txt", "oxts/timestamps.txt", "drive.yaml", "calib_cam_to_cam.txt",
    "calib_velo_to_cam.txt", "calib_imu_to_velo.txt",
)  # fmt: skip


def enlarge(path: Path) -> None:
    with path.open("ab") as file:
        file.truncate(2 * GIGABYTE)


@pytest.fixture
def drive(tmp_path: Path) -> Path:
    return Path(shutil.copytree(SAMPLE, tmp_path / "drive"))


@pytest.fixture
def limited() -> Iterator[None]:
    """A process that may not use much more memory than it does."""
    resource = pytest.importorskip("resource")
    used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    limits = resource.getrlimit(resource.RLIMIT_AS)
    resource.setrlimit(resource.RLIMIT_AS, (used + 300 * 2**20, limits[1]))
    yield
    resource.setrlimit(resource.RLIMIT_AS, limits)


@pytest.mark.usefixtures("limited")
@pytest.mark.parametrize("name", FILES)
def test_a_file_of_gigabytes_is_refused_within_300_mb(drive: Path, name: str) -> None:
    enlarge(drive / name)
    with pytest.raises(DriveFolderError, match=r"expected at most [\d,]+ bytes"):
        read_drive(drive, headers_only=True)
    assert name.startswith("image_03") or "expected at most" in (read_header(drive).problem or "")


@pytest.mark.usefixtures("limited")
def test_a_record_of_gigabytes_costs_its_pair(drive: Path) -> None:
    whole, _ = read_drive(drive, headers_only=True)
    enlarge(drive / "oxts" / "data" / "0000000003.txt")
    found, rejections = read_drive(drive, headers_only=True)
    assert len(whole.frame_pairs) - len(found.frame_pairs) == 1
    assert [rejection.record for rejection in rejections] == ["frame pair 3"]
    assert "at most 10,000 bytes" in rejections[0].detail


@pytest.mark.usefixtures("limited")
def test_a_hole_behind_a_log_costs_nothing(tmp_path: Path) -> None:
    log = tmp_path / "log.csv"
    log.write_text("time,lat,lon\n1,48,11\n")
    with log.open("ab") as file:
        file.truncate(MAX_TEXT_BYTES)
    lines = [line.rstrip("\0") for _, block in line_blocks(log) for line in block]
    assert lines[:2] == ["time,lat,lon", "1,48,11"] and not any(lines[2:])


@pytest.mark.usefixtures("limited")
@pytest.mark.parametrize(
    "text", [b"x\n", b",\n", b"\n", b"#\n", b"1,1,1,1\n", b"lat,lon,time\n", b"$GPGGA,\n", b"," * 999 + b"\n"]
)
@pytest.mark.parametrize("name", ["rtklib", "nmea", "csv", "tum"])
def test_text_behind_a_log_is_read_for_some_lines_only(name: str, text: bytes, tmp_path: Path) -> None:
    sample = files.SAMPLES[name]
    path = sample.write(tmp_path)
    with path.open("ab") as file:
        for _ in range(20):
            file.write(text * (20_000 if len(text) < 100 else 2_000))
    with pytest.raises(InputError, match=r"[\d,]+ lines have 40 usable records: not a log"):
        read_trajectory(path, sample.settings.model_copy(update={"format": sample.format}))


@pytest.mark.usefixtures("limited")
def test_elements_behind_the_points_of_a_track_are_not_read_on(tmp_path: Path) -> None:
    path = files.write_gpx(tmp_path)
    start = path.read_bytes().partition(b"</trkseg")[0]
    for text in (b"<a></a>", b"<trkpt lat='x' lon='y'></trkpt>"):
        path.write_bytes(start + text * 500_000)
        with pytest.raises(
            InputError, match=r"[\d,]+ lines have (0|40) usable records: not a log|tags in [\d,]+ bytes"
        ):
            read_trajectory(path)


@pytest.mark.usefixtures("limited")
@pytest.mark.parametrize(
    ("name", "text", "problem"),
    [
        ("cones.csv", b"8.4,49,100\n" * 1_100_000, "more than 1,000,000 rows"),
        ("lanes.osm", b"<a>" * 2_000_000, "not closed"),
        ("lanes.osm", b"<nd ref='1'/>" * 200_000, "100,001 elements are no nodes or ways"),
        ("lanes.xodr", b"<a></a>" * 2_000_000, "tags in 1,000,000 bytes"),
        ("lanes.geojson", b'{"type":"Feature"}\n' * 600_000, "more than 500,000 features"),
    ],
)
def test_text_that_is_no_map_is_not_read_to_its_end(name: str, text: bytes, problem: str, tmp_path: Path) -> None:
    starts = {".csv": b"lon,lat,height\n8.4,49,100\n", ".osm": b"<osm>", ".xodr": b"<OpenDRIVE>", ".geojson": b""}
    path = tmp_path / name
    path.write_bytes(starts[path.suffix] + text)
    with pytest.raises(InputError, match=problem):
        read_table(path) if path.suffix == ".csv" else LINE_READERS[path.suffix](path)


@pytest.mark.usefixtures("limited")
@pytest.mark.parametrize(
    "text",
    ["<a>" * 1_000_000, json.dumps({f"{n}": {} for n in range(200_000)}), f'{{"a":[{"[]," * 200_000}1]}}',
     "[LEFT_CAM_2K]\nk=1\n" + "\n".join(f"k{n}" for n in range(200_000)), "a: 1 2\n" + "1 2\n" * 200_000],
    ids=["elements", "keys", "lists", "names", "numbers"],
)  # fmt: skip
def test_a_calibration_of_many_values_is_refused(tmp_path: Path, text: str) -> None:
    path = tmp_path / "calib.txt"
    path.write_text(text)
    with pytest.raises(InputError, match="at most 100,000 keys, elements, lists or lines"):
        read_rig(path)


def test_rows_of_numbers_below_a_name_take_their_time_once(tmp_path: Path) -> None:
    path = tmp_path / "calib.txt"
    path.write_text("a: 1 2\n" + f"{'1 ' * 20}\n" * 99_000)
    start = time.process_time()
    assert len(read_content(path)["a"].split()) == 2 + 20 * 99_000
    assert time.process_time() - start < 5


def test_more_lines_than_frame_pairs_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "timestamps.txt"
    path.write_bytes(b"\n" * MAX_TABLE_LINES)
    assert len(read_table_bytes(path)) == MAX_TABLE_LINES
    for end in (b"\n", b"\r", b"\r\n"):
        path.write_bytes(end * (MAX_TABLE_LINES + 1))
        with pytest.raises(InputError, match="at most 300,000 lines"):
            read_table_bytes(path)


def test_lines_end_as_any_system_writes_them() -> None:
    for end in (b"\n", b"\r", b"\r\n"):
        content = b"\xef\xbb\xbfa,b" + end + b"\xff" + end
        assert [line.strip() for line in table_lines(content)] == ["a,b", "\ufffd"]


@pytest.mark.usefixtures("limited")
@pytest.mark.parametrize("line", [b"9" * 100, "\U0010ffff".encode() * 25, b"2026-03-02 09:41:00.25"])
def test_time_stamps_behind_those_of_the_images_cost_nothing(drive: Path, line: bytes) -> None:
    whole, rejections = read_drive(drive, headers_only=True)
    for name in FILES[:3]:
        with (drive / name).open("ab") as file:
            file.write((line + b"\n") * 288_000)
    found, others = read_drive(drive, headers_only=True)
    assert found.frame_pairs == whole.frame_pairs and others == rejections
    assert read_header(drive).problem is None


@pytest.mark.usefixtures("limited")
@pytest.mark.parametrize("write", [formats.write_plain, formats.write_euroc])
def test_more_rows_than_images_that_are_lost_are_refused(tmp_path: Path, write: Callable[..., Path]) -> None:
    root = write(tmp_path, formats.sample_frames(), formats.sample_rig())
    path = next(path for path in (root / "trajectory.csv", root / "mav0/cam0/data.csv") if path.exists())
    with path.open("a") as file:
        file.writelines(f"{k:019d},{k}.jpg\n" for k in range(MAX_LINES_WITHOUT_IMAGE - 10))
    assert read_drive(root, headers_only=True)[0].frame_pairs
    with path.open("a") as file:
        file.writelines(f"{k},{k}.jpg\n" for k in range(200_000))
    with pytest.raises(InputError, match=r"at most 10,0\d\d lines, .*: copy the other images, or remove their lines"):
        read_drive(root, headers_only=True)
    assert "copy the other images" in (read_header(root).problem or "")


@pytest.mark.usefixtures("limited")
@pytest.mark.parametrize("text", ["1 2\n" * 8_000_000, "\n" * 30_000_000])
def test_more_time_stamps_than_images_are_refused(tmp_path: Path, text: str) -> None:
    (tmp_path / "times.txt").write_text(text)
    source = Source(tmp_path, tmp_path, DriveYaml(), ContentHash())
    paths = [Path(f"{k}.jpg") for k in range(3)]
    with pytest.raises(InputError, match=r"at most 10,003 lines, .*: copy the other images"):
        times_of("left", paths, "times.txt", source)
    with pytest.raises(InputError, match=r"at most 10,003 lines, .*: copy the other images"):
        pose_rows.read(tmp_path / "times.txt", [Image(0, path) for path in paths], formats.sample_rig())


@pytest.mark.usefixtures("limited")
def test_truth_larger_than_any_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "truth"
    path.touch()
    enlarge(path)
    with pytest.raises(InputError, match="at most 5,000,000 bytes"):
        read_truth(path)
    with pytest.raises(InputError, match="at most 5,000,000 bytes"):
        read_truth_markings(path, 25832)
    path.write_bytes(b"\0" * 1_000_000)
    with pytest.raises(InputError, match="cannot be read"):
        read_truth(path)


@pytest.mark.usefixtures("limited")
def test_more_plans_or_positions_than_any_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "permits.csv"
    path.write_text("plan_id,starts_at,wkt\n" + "a,b,\n" * (MOST_RECORDS + 1))
    with pytest.raises(InputError, match="more than 50,000 rows: import it in parts"):
        read_plans(path)
    place: dict[str, Any] = {
        "type": "LineString",
        "coordinates": [[8.0, 49.0 + n * 1e-6] for n in range(MOST_POSITIONS + 1)],
    }
    properties = {"plan_id": "a", "starts_at": "2026-03-02T00:00:00Z"}
    document = {"type": "FeatureCollection", "features": [{"properties": properties, "geometry": place}]}
    path = tmp_path / "permits.geojson"
    path.write_text(json.dumps(document))
    [unused] = read_plans(path).unused
    assert unused.reason == "its location has 10,001 positions, expected at most 10,000: simplify it"
    place["coordinates"] = place["coordinates"][1:]
    path.write_text(json.dumps(document))
    assert len(read_plans(path).zones) == 1


def test_a_feed_without_facts_about_itself_is_read(tmp_path: Path) -> None:
    path = tmp_path / "feed.geojson"
    path.write_text('{"feed_info": {}, "features": [{"type": "Feature"}]}')
    [unused] = read_plans(path).unused
    assert unused.reason == "'properties' is missing"


@pytest.mark.usefixtures("limited")
@pytest.mark.parametrize("name", ["permits.csv", "feed.json", "feed.xml", "permits.gpkg"])
def test_a_pipe_is_no_file_of_plans(tmp_path: Path, name: str) -> None:
    os.mkfifo(tmp_path / name)
    with pytest.raises(InputError, match="expected a file, found a folder, a pipe or a device"):
        read_plans(tmp_path / name)


@pytest.mark.usefixtures("limited")
def test_more_columns_than_a_table_has_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "cones.csv"
    path.write_text(",".join(f"c{n}" for n in range(130_000)))
    with pytest.raises(InputError, match="130,000 columns, expected at most 1,600"):
        read_table(path)


@pytest.mark.usefixtures("limited")
def test_a_feature_of_many_positions_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "cones.geojson"
    feature = '{"type":"Feature","properties":{},"geometry":{"type":"MultiPoint","coordinates":['
    path.write_text(f'{{"type":"FeatureCollection","features":[{feature}{"[1,2]," * 10_000_000}[1,2]]}}}}]}}')
    with pytest.raises(InputError, match="too complex/large"):
        read_table(path)


@pytest.mark.usefixtures("limited")
def test_more_points_than_a_survey_has_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "points.csv"
    rows = "458300.123,5427800.456,160.1\n" * (MOST_POINTS + 1)
    path.write_text(f"easting,northing,height\n{rows}")
    with pytest.raises(InputError, match=r"more than 50,000 rows or .*: import it in parts"):
        read_surveyed_points(path, 25832, crs="EPSG:25832", sigma_m=0.02)


@pytest.mark.usefixtures("limited")
@pytest.mark.parametrize(
    ("rows", "refusal"), [(1, "no column wkt"), (2_000, "2,000 columns in 2,001 lines: leave out")]
)
def test_a_table_of_permits_of_many_columns_takes_little_memory(tmp_path: Path, rows: int, refusal: str) -> None:
    path = tmp_path / "permits.csv"
    path.write_text("a," * 1_999 + "b\n" + "1,2\n" * rows)
    with pytest.raises(InputError, match=refusal):
        read_plans(path)
