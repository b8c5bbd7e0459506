"""All readers of files that a stranger may have made: how to write a small valid one, and how to read it."""

from __future__ import annotations

import csv
import json
import shutil
import tempfile
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from functools import cache, partial
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pyogrio
import pyogrio.raw
import rosbags.highlevel.anyreader
import rosbags.serde.cdr
import scipy.io
import shapely
import yaml

from conetl.cli.map.work_zones import Rules
from conetl.exports.zone_feed import read_feed_info
from conetl.files.documents import read_table_bytes, read_yaml_model, table_lines
from conetl.model.errors import ConetlError, InputError
from conetl.model.params import ImportParams, IngestParams
from conetl.model.rig import Camera, Rig
from conetl.perception.images import ImageFileError, check_image_ends, read_image, read_upright_image
from conetl.perception.model_card import read_model_card, shipped_model_path
from conetl.readers.base_layers.las_file import las_chunks, read_las_header
from conetl.readers.base_layers.line_files import read_lane_lines, read_vector_file
from conetl.readers.base_layers.lines import read_lanelet2
from conetl.readers.base_layers.opendrive import read_opendrive
from conetl.readers.drives import read_drive
from conetl.readers.drives.bags import messages as bag_messages
from conetl.readers.drives.header import read_header
from conetl.readers.drives.pairs import PairError
from conetl.readers.drives.proposals import propose
from conetl.readers.drives.velodyne import ScanFileError, left_SE3_velo, list_scans, read_scan, scan_period_s
from conetl.readers.maps.imported_rows import read_map_file
from conetl.readers.plans import read_plans
from conetl.readers.plans.datex2 import read_datex2
from conetl.readers.recording import open_arriving
from conetl.readers.rigs import read_kitti_rig, read_rig, read_rig_for_images, write_rig_yaml
from conetl.readers.surveyed_points import read_surveyed_points
from conetl.readers.trajectories import find_trajectories, read_trajectory
from conetl.readers.trajectories.oxts import parse_oxts
from conetl.readers.trajectories.times import misplaced, parse_timestamps
from tests import recordings
from tests.fuzz import video_files as videos
from tests.prepared import prepared
from tests.recordings import Recorded
from tests.unit.exports import test_datex2 as datex2
from tests.unit.readers import drive_formats as formats
from tests.unit.readers import test_base_layers as layers
from tests.unit.readers import test_device_rigs as device_rigs
from tests.unit.readers import test_osm_xml as osm_texts
from tests.unit.readers import test_plans as plans
from tests.unit.readers import test_rig_formats as rig_files
from tests.unit.readers import test_rig_kinds as rig_kinds
from tests.unit.readers import trajectory_files

#: GeoPackages state when they were written.
pyogrio.set_gdal_config_options({"OGR_CURRENT_DATE": "2026-03-02T10:00:00.000Z"})
WIDTH, HEIGHT = 96, 32
FRAMES = 4
SIDE_FILES = ("calib_velo_to_cam.txt", "calib_imu_to_velo.txt")


class Reader(NamedTuple):
    """One reader: `write` makes a small valid file or folder in a folder, `read` reads it with a folder for its results."""

    write: Callable[[Path], Path]
    read: Callable[[Path, Path], object]


# --------------------------------------------------------------------------- drives


def small_rig() -> Rig:
    camera = Camera(width_px=WIDTH, height_px=HEIGHT, fx_px=60.0, fy_px=60.0, cx_px=47.0, cy_px=15.0)
    full = read_kitti_rig(formats.SAMPLE / "calib_cam_to_cam.txt", body_required=True)
    return full.model_copy(update={"left": camera, "right": camera})


def small_frames(count: int = FRAMES) -> list[formats.Frame]:
    pixels = np.random.default_rng(0).integers(0, 255, (HEIGHT // 8, WIDTH // 8, 3), np.uint8)
    image = bytes(cv2.imencode(".jpg", cv2.resize(pixels, (WIDTH, HEIGHT)))[1])
    return [replace(frame, left=image, right=image) for frame in formats.sample_frames()[:count]]


def _of_small_images(line: str) -> str:
    """A line of KITTI's calibration for images a tenth as large as those of the sample drives."""
    key, *values = line.split()
    if key.startswith("S_rect_0"):
        values = [str(WIDTH), str(HEIGHT)]
    elif key.startswith("P_rect_0"):
        values = [*(str(float(value) / 10) for value in values[:8]), *values[8:]]
    return f"{key} {' '.join(values)}\n"


@prepared
def write_drive(folder: Path, name: str) -> Path:
    path = formats.WRITERS[name](folder / "run", small_frames(), small_rig())
    if name == "kitti":
        calibration = path / "calib_cam_to_cam.txt"
        calibration.write_text("".join(map(_of_small_images, calibration.read_text().splitlines())))
        (path / "drive.yaml").write_text("sigmas: {horizontal_m: 0.02, yaw_deg: 0.1}\ncameras: {left: image_02}\n")
    if name == "plain":
        (path / "drive.yaml").write_text("drive_id: morning\ntimestamps_timezone: Europe/Berlin\nmap_srid: 25832\n")
    if name == "bag":
        (path / "drive.yaml").write_text("pair_tolerance_ms: 4\nantenna_t_m: [0.4, -0.2, 1.1]\n")
    return path


@cache
def small_recording() -> Recorded:
    frames = small_frames(formats.COUNT)
    with tempfile.TemporaryDirectory() as folder:
        drive = read_drive(formats.write_plain(Path(folder) / "run", frames, small_rig()))[0]
    return Recorded(drive, frames)


@prepared
def write_layout(folder: Path, name: str, settings: str = "") -> Path:
    """A layout of `tests/recordings.py`, with a drive.yaml."""
    layout = recordings.layouts("{}")[name]
    (folder / "run").mkdir()
    path = layout.write(folder / "run", small_recording())
    if settings:
        (path / "drive.yaml").write_text(settings)
    return path


def read_after_init(path: Path, scratch: Path) -> object:
    """What `conetl init` finds, then the drive."""
    try:
        proposed: object = propose(path, {"sigmas": {"horizontal_m": 0.02}})
    except ConetlError as error:
        proposed = error
    return [proposed, *read_whole_drive(path, scratch)]


def read_whole_drive(path: Path, scratch: Path) -> list[object]:
    header = read_header(path)
    header.shown_path.encode()
    drive, rejections = read_drive(path, images_folder=scratch)
    drive.model_dump_json()
    return [header, drive, *rejections]


def read_arriving(path: Path, _: Path) -> object:
    arriving = open_arriving(path)
    if arriving is None:
        return None
    found: list[object] = []
    for pair in sorted(arriving.new_pairs(None), key=arriving.order):
        arriving.rig()
        try:
            found.append(arriving.frame_pair(pair, None))
        except PairError as error:
            found.append(error.rejection(pair.key, 0))
    return found


# --------------------------------------------------------------------------- trajectories


def read_any_trajectory(name: str, path: Path, _: Path) -> object:
    """Found by its content, and read in the format that it was written in, whatever its content is now."""
    sample = trajectory_files.SAMPLES[name]
    found = find_trajectories(path.parent)
    with suppress(InputError):
        read_trajectory(path, sample.settings)
    return [found, read_trajectory(path, sample.settings.model_copy(update={"format": sample.format}))]


# --------------------------------------------------------------------------- rigs


@prepared
def written(folder: Path, name: str, text: str | bytes) -> Path:
    (folder / name).write_bytes(text if isinstance(text, bytes) else text.encode())
    return folder / name


def write_kitti_rig(folder: Path) -> Path:
    for name in ("calib_cam_to_cam.txt", *SIDE_FILES):
        shutil.copy(formats.SAMPLE / name, folder / name)
    return folder / "calib_cam_to_cam.txt"


def write_opencv(suffix: str) -> Callable[[Path], Path]:
    values = {
        "M1": rig_files.K1, "D1": rig_files.D1, "M2": rig_files.K2, "D2": rig_files.D2, "R": rig_files.R,
        "T": rig_files.T[:, None], "image_width": 1280, "image_height": 720,
    }  # fmt: skip
    return lambda folder: rig_files.opencv_text(folder / f"stereo{suffix}", values)


def write_rig(folder: Path) -> Path:
    write_rig_yaml(rig_files.make_rig(rig_files.LENSES["brown"]), folder / "rig.yaml")
    with (folder / "rig.yaml").open("a") as file:
        file.write("sigmas: {left.fx_px: 0.5, relative.rx_deg: 0.01}\n")
    return folder / "rig.yaml"


def write_mat(folder: Path) -> Path:
    path = folder / "stereo.mat"
    scipy.io.savemat(path, {"s": rig_files.matlab_content(new=False)})  # plain: mutations reach what is in it
    path.write_bytes(b"MATLAB 5.0 MAT-file".ljust(116) + path.read_bytes()[116:])  # without the time
    return path


def read_chosen_rig(**choice: Any) -> Callable[[Path, Path], object]:
    """A reader of a file with several cameras or resolutions."""
    return lambda path, _: read_rig(path, **choice)


def read_any_rig(path: Path, _: Path) -> object:
    return [read_rig_for_images(path, (1242, 375)), read_rig(path)]


# --------------------------------------------------------------------------- point clouds, lanes, maps

LON_LAT = ((8.42621837, 49.00371264), (8.42632915, 49.00382643), (8.42643752, 49.00393518))
ROWS: dict[str, list[object]] = {
    "category": ["traffic_cone"] * 3, "height_m": [0.5, 0.5, 0.75], "sigma_e_m": [0.02] * 3, "observation_count": [4, 5, 6],
    "feature_id": [f"00000000-0000-4000-8000-00000000000{i}" for i in range(3)],
    "last_seen_at": ["2026-03-02T10:00:00Z", "2026-03-02T10:00:01.5Z", "2026/03/02 10:00:02+01:00"],
}  # fmt: skip


def points() -> np.ndarray:
    return np.asarray(
        shapely.to_wkb([shapely.Point(lon, lat, 115.0) for lon, lat in LON_LAT], output_dimension=3), object
    )


@prepared
def write_by_gdal(folder: Path, name: str, driver: str) -> Path:
    columns = [
        np.array(values) if not isinstance(values[0], str) else np.array(values, object) for values in ROWS.values()
    ]
    pyogrio.raw.write(
        folder / name, points(), columns, list(ROWS), geometry_type="Point Z", crs="EPSG:4326", driver=driver
    )
    return folder / name


def write_map_csv(folder: Path) -> Path:
    with (folder / "map.csv").open("w", newline="") as file:
        rows = csv.writer(file)
        rows.writerow(["lon_deg", "lat_deg", "ellipsoidal_height_m", *ROWS])
        rows.writerows([*lon_lat, 115.0, *values] for lon_lat, *values in zip(LON_LAT, *ROWS.values(), strict=True))
    return folder / "map.csv"


def write_geoparquet(folder: Path) -> Path:
    geo = {
        "version": "1.1.0",
        "primary_column": "geometry",
        "columns": {"geometry": {"encoding": "WKB", "geometry_types": []}},
    }
    table = pa.table({**ROWS, "geometry": [bytes(p) for p in points()]})
    pq.write_table(table.replace_schema_metadata({"geo": json.dumps(geo)}), folder / "map.parquet")
    return folder / "map.parquet"


def read_map(path: Path, _: Path) -> object:
    return [*read_map_file(path, ImportParams(), map_srid=32632).statements]  # made where they are used


def write_surveyed(folder: Path) -> Path:
    rows = [f"P{n},{458300 + 9 * n},5427840.5,116.2,0.01,0.01,0.02" for n in range(3)]
    header = "name,easting,northing,height_m,sigma_e_m,sigma_n_m,sigma_u_m"
    (folder / "points.csv").write_text("\n".join([header, *rows]) + "\n")
    return folder / "points.csv"


def read_points(path: Path, _: Path) -> object:
    count, crs = read_las_header(path)
    return [count, crs, *las_chunks(path, count)]


def read_lines(path: Path, _: Path) -> object:
    reader = {".osm": read_lanelet2, ".xodr": read_opendrive}.get(path.suffix, read_vector_file)
    found = reader(path)
    json.dumps([dict(line.attributes) for line in found.lines])
    return [found, read_lane_lines(path, srid=32632)]


@prepared
def write_lanes(folder: Path, name: str, driver: str) -> Path:
    lines = np.asarray(shapely.to_wkb([shapely.LineString(LON_LAT), shapely.LineString(LON_LAT[1:])]), object)
    kinds = [np.array(["solid", "dashed"], object), np.array([0.12, 0.15])]
    pyogrio.raw.write(
        folder / name, lines, kinds, ["kind", "width"], geometry_type="LineString", crs="EPSG:4326", driver=driver
    )
    return folder / name


# --------------------------------------------------------------------------- small files of drives


def write_scans(folder: Path) -> Path:
    data = folder / "run/velodyne_points/data"
    data.mkdir(parents=True)
    for i in range(2):
        np.random.default_rng(i).uniform(-20, 20, (40, 4)).astype("<f4").tofile(data / f"{i:010d}.bin")
    for name in ("start", "end"):
        stamps = "".join(f"2026-03-02 10:00:0{i}.{'1' if name == 'end' else '0'}00000000\n" for i in range(2))
        (data.parent / f"timestamps_{name}.txt").write_text(stamps)
    write_kitti_rig(folder / "run")
    return folder / "run"


def read_scans(path: Path, _: Path) -> object:
    found: list[object] = [scan_period_s(path)]
    for scan in list_scans(path).values():
        try:
            found.append(read_scan(scan))
        except ScanFileError as error:
            found.append(str(error))
    return [*found, left_SE3_velo(read_kitti_rig(path / "calib_cam_to_cam.txt", body_required=True), path)]


def read_stamps(path: Path, _: Path) -> object:
    stamps = parse_timestamps(table_lines(read_table_bytes(path)), "Europe/Berlin")
    return [stamps, misplaced({number: time for number, time in stamps.items() if isinstance(time, int)})]


def read_oxts(path: Path, _: Path) -> object:
    try:
        return parse_oxts(path.read_bytes().decode(errors="replace"))
    except ValueError as error:  # which readers of drives make a rejection of
        return str(error)


def read_one_image(path: Path, _: Path) -> object:
    found: list[object] = []
    for read in (lambda: read_image(path, (WIDTH, HEIGHT)), lambda: read_image(path), lambda: read_upright_image(path),
                 lambda: check_image_ends(path, path.name, (WIDTH, HEIGHT))):  # fmt: skip
        try:
            found.append(read())
        except ImageFileError as error:
            assert len(str(error)) < 500, str(error)[:1000]
            found.append(str(error))
    return found


def image_bytes(suffix: str, *flags: int, channels: int = 3) -> bytes:
    pixels = np.random.default_rng(1).integers(0, 255, (HEIGHT, WIDTH, channels), np.uint8)
    return bytes(cv2.imencode(suffix, pixels, list(flags))[1])


PARAMS = {
    "detection": {"score_threshold": 0.4, "search_right": "everywhere"}, "match": {"max_range_m": 30.0, "refine": True},
    "track": {"max_gap_frames": 9}, "reconcile": {"gate_chi2": 12}, "chunk_pairs": 64,
}  # fmt: skip
RULES = {"layout": {"sigmas": 2.5}, "zones": {"min_cones": 4, "kerb_side": "left", "lane_width_m": [2.4, 4.8]}}
FEED = {"publisher": "City", "road_names": ["A 8", "B 10"], "contact_email": "a@b.de", "update_frequency_s": 60}


def write_permits(folder: Path) -> Path:
    fields = [np.array(values, object) for values in (["A", "B"], ["2026-03-01T00:00Z"] * 2)]
    shapes = shapely.to_wkb([shapely.Point(8.4, 49.0), shapely.Point(8.5, 49.0)])
    path = folder / "p.gpkg"
    pyogrio.raw.write(path, shapes, fields, ["id", "start"], geometry_type="Point", crs="EPSG:4326")
    return path


def write_card(folder: Path) -> Path:
    card = shipped_model_path()
    return written("m.onnx.json", card.with_name(card.name + ".json").read_bytes())(folder)


def cached(function: Callable[..., Any]) -> Callable[..., Any]:
    results: dict[str, Any] = {}

    def call(*args: Any) -> Any:
        if len(results) > 300:
            results.clear()
        key = repr(args)
        if key not in results:
            results[key] = function(*args)
        return results[key]

    return call


# Most of the time of a small bag is that for its message types, which are the same in nearly all cases.
for module, function in (
    (rosbags.serde.cdr, "compile_lines"), (rosbags.highlevel.anyreader, "get_types_from_msg"),
    (bag_messages, "get_types_from_msg"),
):  # fmt: skip
    setattr(module, function, cached(getattr(module, function)))

ODOMETRY = """images: {left: image_2, right: image_3, timestamps: times.txt, start: '2026-03-02 10:00:00.25Z'}
trajectory: {file: poses.txt}
georeference: {lon_deg: 8.43, lat_deg: 49.0, height_m: 116, heading_deg: 57, roll_deg: 0.2, pitch_deg: -0.1}
sigmas: {horizontal_m: 0.02}
"""
LISTED = "images: {left: left, right: right, timestamps: rgb.txt, right_timestamps: right.txt, crop: [0, 0, 96, 32]}\n"
CHAPTERS = """images: {left: GX??0042_L.MP4, right: GX??0042_R.MP4, start: '2026-03-02 09:41:07.25Z', right_offset_s: 0}
"""
READERS: dict[str, Reader] = {
    **{name.replace(" ", "_"): Reader(write_drive(name), read_whole_drive) for name in formats.WRITERS},
    "kitti_arriving": Reader(write_drive("kitti"), read_arriving),
    "plain_arriving": Reader(write_drive("plain"), read_arriving),
    **{
        f"video_{suffix}": Reader(videos.write_video(suffix, small_rig(), 6), videos.read_video_drive)
        for suffix in videos.CODECS
    },
    "video_listed_times": Reader(
        videos.write_video("mp4", small_rig(), 6, "images: {{timestamps: times.txt, right_timestamps: times.txt}}\n"),
        videos.read_video_drive,
    ),
    "foxglove": Reader(write_layout("Foxglove images"), read_whole_drive),
    "foxglove_video": Reader(write_layout("Foxglove video"), read_whole_drive),
    "packed_bag": Reader(write_layout(".db3.zstd"), read_whole_drive),
    "kitti_odometry": Reader(write_layout("KITTI odometry, colour", ODOMETRY), read_after_init),
    "listed_images": Reader(write_layout("TUM's rgb.txt", LISTED), read_after_init),
    "chapters": Reader(write_layout("GoPro chapters in one folder", CHAPTERS), read_after_init),
    "video_search": Reader(videos.write_video("mp4", small_rig(), 40, "images: {{}}\n"), videos.search_times),
    "oxts": Reader(lambda f: Path(shutil.copy(formats.SAMPLE / "oxts/data/0000000000.txt", f)), read_oxts),
    "timestamps": Reader(lambda f: Path(shutil.copy(formats.SAMPLE / "oxts/timestamps.txt", f)), read_stamps),
    "velodyne": Reader(write_scans, read_scans),
    **{
        f"trajectory_{name}": Reader(sample.write, partial(read_any_trajectory, name))
        for name, sample in trajectory_files.SAMPLES.items()
    },
    "rig_yaml": Reader(write_rig, read_any_rig),
    "rig_kitti": Reader(write_kitti_rig, read_any_rig),
    "rig_opencv_yml": Reader(write_opencv(".yml"), read_any_rig),
    "rig_opencv_xml": Reader(write_opencv(".xml"), read_any_rig),
    "rig_opencv_json": Reader(write_opencv(".json"), read_any_rig),
    "rig_kalibr": Reader(written("camchain.yaml", yaml.safe_dump(rig_files.kalibr_content())), read_any_rig),
    "rig_ros": Reader(rig_files.ros_pair, read_any_rig),
    "rig_matlab_json": Reader(written("s.json", json.dumps(rig_files.matlab_content(new=True))), read_any_rig),
    "rig_matlab_mat": Reader(write_mat, read_any_rig),
    "rig_zed": Reader(written("SN1.conf", device_rigs.zed_text()), read_chosen_rig(image_size=(1280, 720))),
    "rig_oak": Reader(written("calib.json", json.dumps(device_rigs.oak_content())), read_any_rig),
    "rig_metashape": Reader(written("cameras.xml", device_rigs.metashape_text()), read_any_rig),
    **{
        f"rig_{name.lower().replace(' ', '_')}": Reader(
            written("calib.txt", rig_kinds.SAMPLES[name].text), read_chosen_rig(**rig_kinds.SAMPLES[name].options)
        )
        for name in ("KITTI object", "Middlebury", "oST", "ORB-SLAM2 raw", "ORB-SLAM3 fisheye", "OpenVINS")
    },
    "rig_of_many": Reader(
        written("rig.yaml", yaml.safe_dump(device_rigs.rig_of_many()[0])), read_chosen_rig(pair=("l", "r"))
    ),
    "image_jpeg": Reader(written("a.jpg", image_bytes(".jpg")), read_one_image),
    "image_tiff": Reader(written("a.tiff", image_bytes(".tiff")), read_one_image),
    "image_bmp": Reader(written("a.bmp", image_bytes(".bmp")), read_one_image),
    "image_webp": Reader(written("a.webp", image_bytes(".webp")), read_one_image),
    "image_png": Reader(written("a.png", image_bytes(".png", channels=4)), read_one_image),
    "points_las": Reader(lambda f: layers.write_las(f / "a.las", 50), read_points),
    "points_laz": Reader(lambda f: layers.write_las(f / "a.laz", 50), read_points),
    "lanes_lanelet2": Reader(written("a.osm", layers.OSM), read_lines),
    "lanes_osm": Reader(written("a.osm", osm_texts.PLAIN), read_lines),
    "lanes_opendrive": Reader(written("a.xodr", layers.XODR), read_lines),
    "lanes_geojson": Reader(write_lanes("a.geojson", "GeoJSON"), read_lines),
    "lanes_gpkg": Reader(write_lanes("a.gpkg", "GPKG"), read_lines),
    "map_geojson": Reader(write_by_gdal("map.geojson", "GeoJSON"), read_map),
    "map_csv": Reader(write_map_csv, read_map),
    "map_gpkg": Reader(write_by_gdal("map.gpkg", "GPKG"), read_map),
    "map_fgb": Reader(write_by_gdal("map.fgb", "FlatGeobuf"), read_map),
    "map_parquet": Reader(write_geoparquet, read_map),
    "surveyed_points": Reader(write_surveyed, lambda path, _: read_surveyed_points(path, 32632, crs="EPSG:25832")),
    "params": Reader(
        written("p.yaml", yaml.safe_dump(PARAMS)), lambda path, _: read_yaml_model(path, IngestParams, "parameters")
    ),
    "rules": Reader(written("r.yaml", yaml.safe_dump(RULES)), lambda path, _: read_yaml_model(path, Rules, "rules")),
    "feed": Reader(written("f.yaml", yaml.safe_dump(FEED)), lambda path, _: read_feed_info(path)),
    "datex2": Reader(
        lambda folder: datex2.publication(folder / "d.xml", {}, {"version": "2"}), lambda path, _: read_datex2(path)
    ),
    "planned_works": Reader(
        lambda folder: plans.works_file(folder / "w.xml", plans.OLD, plans.old_works(), plans.new_works()),
        lambda path, _: read_plans(path),
    ),
    "wzdx": Reader(
        written("w.geojson", json.dumps(plans.feed(plans.event(1), plans.event(2)))), lambda path, _: read_plans(path)
    ),
    "permits": Reader(
        written("p.geojson", json.dumps({"features": [plans.permit(), plans.permit(permit_id="B")]})),
        lambda path, _: read_plans(path),
    ),
    "permits_csv": Reader(
        written("p.csv", "id,from,until,lon,lat,lon_end,lat_end\nA,2026-03-01T00:00Z,2026-03-03,8.43,49,8.431,49\n"),
        lambda path, _: read_plans(path, time_zone="Europe/Berlin"),
    ),
    "permits_gpkg": Reader(write_permits, lambda path, _: read_plans(path)),
    "model_card": Reader(write_card, lambda path, _: read_model_card(path.with_suffix(""))),
}
