"""One file -> one base layer: read, georeference, check, write. Nothing is written before the whole file was read."""

from __future__ import annotations

import hashlib
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from conetl.db.base_store import (
    BaseCounts,
    BaseFile,
    Kind,
    PlacedLine,
    find_base_file,
    read_ingested_poses,
    write_lines,
    write_points,
)
from conetl.db.connection import Connection
from conetl.geometry import pose as se3
from conetl.geometry.rig import map_SE3_left
from conetl.model.errors import InputError
from conetl.model.records import Drive
from conetl.readers.base_layers import georeferencing as placing
from conetl.readers.base_layers.georeferencing import MapPlace
from conetl.readers.base_layers.las_file import las_chunks, read_las_header
from conetl.readers.base_layers.layer_crs import LayerCrs, to_map
from conetl.readers.base_layers.line_files import LINE_READERS
from conetl.readers.base_layers.lines import LineFile
from conetl.readers.base_layers.point_tiles import Cloud, tiles_of, top_level
from conetl.readers.base_layers.spill import Spilled, read_cells, spill
from conetl.readers.drives import read_drive
from conetl.readers.drives.velodyne import (
    ScanFileError,
    left_SE3_velo,
    list_scans,
    points_at_exposure,
    read_scan,
    scan_period_s,
)
from conetl.readers.rigs import IMU_TO_VELO

POINT_SUFFIXES = (".las", ".laz")
#: Number of points whose position is checked.
_CHECKED = 20_000


@dataclass(frozen=True)
class ImportOptions:
    """The user's options for a file."""

    map_name: str
    layer_name: str
    crs: str | None
    voxel_m: float
    height_offset_m: float


@dataclass
class ImportedLayerFile:
    """The result for one file."""

    file: str
    layer: str
    kind: Kind
    kept: int
    read: int = 0
    refused: int = 0
    unchanged: bool = False
    """True where the same import was there already."""
    warnings: list[str] = field(default_factory=list)
    refusals: list[str] = field(default_factory=list)


def kind_of(path: Path) -> Kind:
    """Kind of layer of a file or folder, by its name. Raises InputError."""
    suffix = path.suffix.lower()
    if path.is_dir() or suffix in POINT_SUFFIXES:
        return "points"
    if suffix in LINE_READERS:
        return "lines"
    raise InputError(
        f"{path}: unknown kind of file; expected .las, .laz (also .copc.laz) or a drive folder with LiDAR for "
        f"points, {', '.join(LINE_READERS)} for lines"
    )


def import_file(
    conn: Connection, path: Path, place: MapPlace, options: ImportOptions, progress: Callable[[int, int], None]
) -> ImportedLayerFile:
    """Import one file. progress: called with (done, all) points or scans. Raises InputError, and then wrote nothing."""
    if not path.exists():
        raise InputError(f"{path}: there is no such file")
    if path.is_dir():
        return _import_drive(conn, path, place, options, progress)
    if kind_of(path) == "points":
        return _import_las(conn, path, place, options, progress)
    return _import_lines(conn, path, place, options)


def _import_las(
    conn: Connection, path: Path, place: MapPlace, options: ImportOptions, progress: Callable[[int, int], None]
) -> ImportedLayerFile:
    count, stated = read_las_header(path)
    layer, warnings = placing.resolve_crs(path, stated, options.crs, place)
    file = _base_file(path, "points", _sha256(path), options, layer.name)
    if (there := find_base_file(conn, file)) is not None:
        return _unchanged(file, there)

    def placed() -> Iterator[Cloud]:
        done = 0
        for cloud in las_chunks(path, count):
            if done == 0 and len(cloud.xyz_m):
                warnings.extend(placing.check_coordinates(path, layer, cloud.xyz_m[:, :2], place))
            done += len(cloud.xyz_m)
            yield Cloud(to_map(layer, cloud.xyz_m, options.height_offset_m), cloud.shade)
            progress(done, count)

    return _write_cloud(conn, file, placed(), count, place, options, warnings)


def _import_drive(
    conn: Connection, path: Path, place: MapPlace, options: ImportOptions, progress: Callable[[int, int], None]
) -> ImportedLayerFile:
    if options.crs:
        raise InputError(f"{path}: a drive's LiDAR is placed by the drive's poses; --crs has no meaning for it")
    scans = list_scans(path)
    if not scans:
        raise InputError(
            f"{path}: no LiDAR in this folder; expected a drive with velodyne_points/data/0000000000.bin and so on"
        )
    folders = [f for f in (path, path.resolve().parent) if (f / IMU_TO_VELO).is_file()]
    if not folders:
        raise InputError(f"{path}: {IMU_TO_VELO} is neither in the drive folder nor in its parent")
    drive, _ = read_drive(path, map_srid=place.srid)
    poses = read_ingested_poses(conn, options.map_name, drive.content_sha256)
    content = hashlib.sha256(drive.content_sha256.encode())
    for pose in poses.values():
        content.update(pose.tobytes())
    for scan in scans.values():
        content.update(bytes.fromhex(_sha256(scan)))
    file = _base_file(path, "points", content.hexdigest(), options, f"EPSG:{place.srid}")
    if (there := find_base_file(conn, file)) is not None:
        return _unchanged(file, there)
    warnings = (
        []
        if poses
        else [f"{path.name}: is not on the map: placed by its logged poses. Ingest it first, then its refined ones do"]
    )
    refusals: list[str] = []
    read = [0]
    clouds = _drive_clouds(
        drive, poses, scans, left_SE3_velo(drive.rig, folders[0]), scan_period_s(path), refusals, read, progress
    )
    done = _write_cloud(conn, file, clouds, None, place, options, warnings, read)
    done.refusals += refusals
    return done


def _drive_clouds(
    drive: Drive, poses: dict[int, Any], scans: dict[int, Path], velo: Any, period_s: float, refusals: list[str], read: list[int],
    progress: Callable[[int, int], None],
) -> Iterator[Cloud]:  # fmt: skip
    """One cloud a scan, on the map. poses: (4, 4) map_SE3_body by frame that go before the drive's own."""
    pairs = {}
    for pair in drive.frame_pairs:
        better = poses.get(pair.frame_index)
        pairs[pair.frame_index] = pair
        if better is not None:
            pose = pair.pose.model_copy(
                update={
                    "map_R_body": tuple(map(tuple, better[:3, :3].tolist())),
                    "map_t_body_m": tuple(better[:3, 3].tolist()),
                }
            )
            pairs[pair.frame_index] = pair.model_copy(update={"pose": pose})
    for done, (number, path) in enumerate(scans.items(), 1):
        progress(done, len(scans))
        placed_pair = pairs.get(number)
        if placed_pair is None:
            refusals.append(f"scan {path.name}: there is no usable frame pair {number}")
            continue
        try:
            scan = read_scan(path)
        except ScanFileError as error:
            refusals.append(str(error))
            continue
        read[0] += len(scan)
        points = points_at_exposure(scan[:, :3].astype(np.float64), placed_pair, pairs, drive.rig, velo, period_s)
        shade = np.clip(np.rint(scan[:, 3] * 255.0), 0, 255).astype(np.uint8)
        yield Cloud(se3.apply(se3.compose(map_SE3_left(placed_pair.pose, drive.rig), velo), points), shade)


def _write_cloud(
    conn: Connection, file: BaseFile, clouds: Iterator[Cloud], count: int | None, place: MapPlace, options: ImportOptions,
    warnings: list[str], read: list[int] | None = None,
) -> ImportedLayerFile:  # fmt: skip
    with tempfile.TemporaryDirectory(prefix="conetl-points-") as name:
        folder = Path(name)
        spilled = spill(clouds, folder, options.voxel_m, file.source_path)
        total = count if count is not None else read[0] if read else spilled.kept
        low, high = np.array(spilled.low_m), np.array(spilled.high_m)
        label = Path(file.source_path).name
        warnings += placing.check_near(label, low, high, place)
        warnings += placing.check_heights(label, _some_points(folder, spilled), place)
        extent_m = float((high - low).max())
        tiles = tiles_of(read_cells(folder, spilled.cells), top_level(extent_m), options.voxel_m)
        kept = write_points(conn, file, BaseCounts(total, spilled.refused, spilled.low_m, spilled.high_m), tiles)
    if kept is None:
        return _unchanged(file, 0)
    refusals = [f"{spilled.refused:,} points are no numbers in the map's CRS"] if spilled.refused else []
    return ImportedLayerFile(
        file.source_path, file.layer_name, "points", kept, total, spilled.refused, False, warnings, refusals
    )


def _some_points(folder: Path, spilled: Spilled) -> Any:
    """A thin sample of what was spilled, (N, 3)."""
    step = max(spilled.kept // _CHECKED, 1)
    cells = spilled.cells[:: max(len(spilled.cells) // 400, 1)]
    return np.concatenate([cloud.xyz_m[::step] for _, _, cloud in read_cells(folder, cells)])


def _import_lines(conn: Connection, path: Path, place: MapPlace, options: ImportOptions) -> ImportedLayerFile:
    found = LINE_READERS[path.suffix.lower()](path)
    layer, warnings = placing.resolve_crs(path, found.crs, options.crs, place)
    everything = np.concatenate([line.xyz for line in found.lines])
    warnings += placing.check_coordinates(path, layer, everything[:, :2], place)
    flat = [bool(np.isnan(line.xyz[:, 2]).any()) for line in found.lines]
    if any(flat) and len(place.ground_m) == 0:
        raise InputError(
            f"{path}: its lines have no heights, and map {options.map_name} has no drive to take them from: ingest one first"
        )
    file = _base_file(path, "lines", _sha256(path), options, layer.name, heights="drives" if any(flat) else "file")
    if (there := find_base_file(conn, file)) is not None:
        return _unchanged(file, there)
    refused = list(found.refused)
    lines = _placed_lines(found, layer, place, options, refused)
    if not lines:
        raise InputError(f"{path}: none of its lines can be placed on the map; {refused[0]}")
    vertices = np.concatenate([line.xyz_m for line in lines])
    low, high = vertices[:, :2].min(axis=0), vertices[:, :2].max(axis=0)
    warnings += placing.check_near(path.name, low, high, place)
    if not all(flat):
        warnings += placing.check_heights(path.name, vertices, place)
    counts = BaseCounts(
        len(lines) + len(refused), len(refused), (float(low[0]), float(low[1])), (float(high[0]), float(high[1]))
    )
    kept = write_lines(conn, file, counts, lines, place.srid)
    if kept is None:
        return _unchanged(file, 0)
    return ImportedLayerFile(
        file.source_path, file.layer_name, "lines", kept, counts.read_count, len(refused), False, warnings, refused
    )


def _placed_lines(
    found: LineFile, layer: LayerCrs, place: MapPlace, options: ImportOptions, refused: list[str]
) -> list[PlacedLine]:
    lines = []
    for number, line in enumerate(found.lines):
        xyz = to_map(layer, line.xyz, options.height_offset_m)
        if not np.isfinite(xyz[:, :2]).all():
            refused.append(f"line {number} ({line.kind}): its coordinates cannot be expressed in EPSG:{place.srid}")
            continue
        missing = np.isnan(xyz[:, 2])
        if missing.any():
            xyz[missing, 2] = placing.drape(xyz[missing, :2], place)
        lines.append(PlacedLine(line.kind, xyz, line.attributes))
    return lines


def _base_file(
    path: Path, kind: Kind, sha256: str, options: ImportOptions, crs: str, heights: Any = "file"
) -> BaseFile:
    params: dict[str, Any] = {"crs": options.crs, "height_offset_m": options.height_offset_m}
    if kind == "points":
        params["voxel_m"] = options.voxel_m
    return BaseFile(options.map_name, options.layer_name, kind, str(path.resolve()), sha256, params, crs, heights)


def _unchanged(file: BaseFile, kept: int) -> ImportedLayerFile:
    return ImportedLayerFile(file.source_path, file.layer_name, file.kind, kept, unchanged=True)


def _sha256(path: Path) -> str:
    try:
        with path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror})") from error
