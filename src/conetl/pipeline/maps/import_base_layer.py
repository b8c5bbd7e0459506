"""Import one file as one base layer: read, transform, check, write. Nothing is written before the complete file was read."""

from __future__ import annotations

import hashlib
import tempfile
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from conetl.db import base_store as store
from conetl.db.connection import Connection
from conetl.files.documents import input_errors
from conetl.files.parquet_store import file_sha256
from conetl.files.storage import NOT_A_FILE
from conetl.geometry import pose as se3
from conetl.geometry.packing import vec3
from conetl.geometry.rig import map_SE3_left
from conetl.model.drive import Drive, FramePair
from conetl.model.errors import InputError
from conetl.readers.base_layers import georeferencing as geo
from conetl.readers.base_layers.georeferencing import LayerCrs, MapGround, to_map
from conetl.readers.base_layers.las_file import las_chunks, read_las_header
from conetl.readers.base_layers.line_files import LINE_READERS
from conetl.readers.base_layers.lines import Line, LineFile
from conetl.readers.base_layers.point_tiles import Cloud, Spilled, read_cells, spill, tiles_of, top_level
from conetl.readers.drives import read_drive, velodyne

POINT_SUFFIXES = (".las", ".laz")
#: Points of the sample whose heights are checked.
_CHECKED = 20_000


@dataclass
class ImportedFile:
    """The result of one file."""

    file: str
    layer: str
    kind: store.Kind
    kept: int
    read: int = 0
    refused: int = 0
    unchanged: bool = False
    """True if the same import existed already."""
    warnings: list[str] = field(default_factory=list)
    refusals: list[str] = field(default_factory=list)


class FileImport(NamedTuple):
    """What to import: a file, the map to import it into, and the user's options."""

    conn: Connection
    path: Path
    ground: MapGround
    map_name: str
    layer_name: str
    crs: str | None
    voxel_m: float
    height_offset_m: float
    progress: Callable[[int, int], None]
    """Called with (done, total) points or scans."""

    def base_file(self, kind: store.Kind, sha256: str, crs: str, heights: Any = "file") -> store.BaseFile:
        params: dict[str, Any] = {"crs": self.crs, "height_offset_m": self.height_offset_m}
        if kind == "points":
            params["voxel_m"] = self.voxel_m
        source = str(self.path.resolve())
        return store.BaseFile(self.map_name, self.layer_name, kind, source, sha256, params, crs, heights)


def kind_of(path: Path) -> store.Kind:
    """The kind of a file or folder, by its name. Raises InputError."""
    suffix = path.suffix.lower()
    if path.is_dir() or suffix in POINT_SUFFIXES:
        return "points"
    if suffix in LINE_READERS:
        return "lines"
    raise InputError(
        f"{path}: unknown kind of file; expected .las, .laz (also .copc.laz) or a drive folder with LiDAR for "
        f"points, {', '.join(LINE_READERS)} for lines"
    )


def import_file(job: FileImport) -> ImportedFile:
    """Import one file. Raises InputError, with nothing written."""
    if not job.path.exists():
        raise InputError(f"{job.path}: there is no such file")
    if job.path.is_dir():
        return _import_drive(job)
    if not job.path.is_file():
        raise InputError(f"{job.path}: {NOT_A_FILE}")
    return _import_las(job) if kind_of(job.path) == "points" else _import_lines(job)


def _import_las(job: FileImport) -> ImportedFile:
    path, ground = job.path, job.ground
    count, stated = read_las_header(path)
    layer, warnings = geo.resolve_crs(path, stated, job.crs, ground)
    file = job.base_file("points", _sha256(path), layer.name)
    if (kept := store.find_base_file(job.conn, file)) is not None:
        return _unchanged(file, kept)

    def on_map() -> Iterator[Cloud]:
        done = 0
        for cloud in las_chunks(path, count):
            if done == 0 and len(cloud.xyz_m):
                warnings.extend(geo.check_coordinates(path, layer, cloud.xyz_m[:, :2], ground))
            done += len(cloud.xyz_m)
            yield Cloud(to_map(layer, cloud.xyz_m, job.height_offset_m), cloud.shade)
            job.progress(done, count)

    return _write_cloud(job, file, on_map(), warnings, [count])


def _import_drive(job: FileImport) -> ImportedFile:
    path = job.path
    if job.crs:
        raise InputError(f"{path}: a drive's LiDAR is georeferenced by the drive's poses; --crs does not apply")
    scans = velodyne.list_scans(path)
    if not scans:
        raise InputError(
            f"{path}: no LiDAR in this folder; expected a drive with velodyne_points/data/0000000000.bin and so on"
        )
    drive, _ = read_drive(path, map_srid=job.ground.srid)
    velo = velodyne.left_SE3_velo(drive.rig, path)
    poses = store.read_ingested_poses(job.conn, job.map_name, drive.content_sha256)
    content = hashlib.sha256(drive.content_sha256.encode())
    for pose in poses.values():
        content.update(pose.tobytes())
    for scan in scans.values():
        content.update(bytes.fromhex(_sha256(scan)))
    file = job.base_file("points", content.hexdigest(), f"EPSG:{job.ground.srid}")
    if (kept := store.find_base_file(job.conn, file)) is not None:
        return _unchanged(file, kept)
    advice = "Ingest it first to use its refined poses"
    warnings = [] if poses else [f"{path.name}: is not on the map: georeferenced by its logged poses. {advice}"]
    refusals: list[str] = []
    read = [0]
    pairs = {pair.frame_index: pair for pair in drive.frame_pairs}
    for index in pairs.keys() & poses.keys():
        rotation, place = poses[index][:3, :3], poses[index][:3, 3]
        pairs[index] = pairs[index].with_pose(map_R_body=se3.to_matrix3(rotation), map_t_body_m=vec3(place))
    clouds = _drive_clouds(job, drive, pairs, scans, velo, refusals, read)
    done = _write_cloud(job, file, clouds, warnings, read)
    done.refusals += refusals
    return done


def _drive_clouds(
    job: FileImport, drive: Drive, pairs: Mapping[int, FramePair], scans: Mapping[int, Path], velo: Any, refusals: list[str],
    read: list[int],
) -> Iterator[Cloud]:  # fmt: skip
    """One cloud per scan, on the map. velo: (4, 4) left_SE3_velo. read[0] counts the points."""
    period_s = velodyne.scan_period_s(job.path)
    for done, (number, path) in enumerate(scans.items(), 1):
        job.progress(done, len(scans))
        pair = pairs.get(number)
        if pair is None:
            refusals.append(f"scan {path.name}: there is no usable frame pair {number}")
            continue
        try:
            scan = velodyne.read_scan(path)
        except velodyne.ScanFileError as error:
            refusals.append(str(error))
            continue
        read[0] += len(scan)
        points = velodyne.points_at_exposure(scan[:, :3].astype(np.float64), pair, pairs, drive.rig, velo, period_s)
        shade = np.clip(np.rint(scan[:, 3] * 255.0), 0, 255).astype(np.uint8)
        yield Cloud(se3.apply(se3.compose(map_SE3_left(pair.pose, drive.rig), velo), points), shade)


def _write_cloud(
    job: FileImport, file: store.BaseFile, clouds: Iterator[Cloud], warnings: list[str], read: list[int]
) -> ImportedFile:
    """Write the tiles. read[0]: number of points before thinning, known when all clouds were read."""
    voxel_m = job.voxel_m
    with tempfile.TemporaryDirectory(prefix="conetl-points-") as name:
        folder = Path(name)
        spilled = spill(clouds, folder, voxel_m, file.source_path)
        low, high = np.array(spilled.low_m), np.array(spilled.high_m)
        label = Path(file.source_path).name
        warnings += geo.check_near(label, low, high, job.ground)
        warnings += geo.check_heights(label, _some_points(folder, spilled), job.ground)
        tiles = tiles_of(read_cells(folder, spilled.cells), top_level(float((high - low).max())), voxel_m)
        counts = store.BaseCounts(read[0], spilled.refused, *spilled.low_m, *spilled.high_m)
        kept = store.write_points(job.conn, file, counts, tiles)
    refusals = [f"{spilled.refused:,} points have no coordinates in the map's CRS"] if spilled.refused else []
    return _imported(file, kept, counts, warnings, refusals)


def _some_points(folder: Path, spilled: Spilled) -> Any:
    """A sample of the spilled points, (N, 3)."""
    step = max(spilled.kept // _CHECKED, 1)
    cells = spilled.cells[:: max(len(spilled.cells) // 400, 1)]
    return np.concatenate([cloud.xyz_m[::step] for _, _, cloud in read_cells(folder, cells)])


def _import_lines(job: FileImport) -> ImportedFile:
    path, ground = job.path, job.ground
    found = LINE_READERS[path.suffix.lower()](path)
    layer, warnings = geo.resolve_crs(path, found.crs, job.crs, ground, found.why_no_crs)
    everything = np.concatenate([line.xyz for line in found.lines])
    warnings += geo.check_coordinates(path, layer, everything[:, :2], ground)
    flat = [bool(np.isnan(line.xyz[:, 2]).any()) for line in found.lines]
    if any(flat) and len(ground.ground_m) == 0:
        raise InputError(
            f"{path}: its lines have no heights, and map {job.map_name} has no drive for them: ingest one first"
        )
    file = job.base_file("lines", _sha256(path), layer.name, "drives" if any(flat) else "file")
    if (kept := store.find_base_file(job.conn, file)) is not None:
        return _unchanged(file, kept)
    refused = list(found.refused)
    lines = _lines_on_map(job, found, layer, refused)
    if not lines:
        raise InputError(f"{path}: none of its lines is on the map; {refused[0]}")
    vertices = np.concatenate([line.xyz for line in lines])
    low, high = vertices[:, :2].min(axis=0), vertices[:, :2].max(axis=0)
    warnings += geo.check_near(path.name, low, high, ground)
    if not all(flat):
        warnings += geo.check_heights(path.name, vertices, ground)
    counts = store.BaseCounts(len(lines) + len(refused), len(refused), *low.tolist(), *high.tolist())
    written = store.write_lines(job.conn, file, counts, lines, ground.srid)
    return _imported(file, written, counts, warnings, refused)


def _lines_on_map(job: FileImport, found: LineFile, layer: LayerCrs, refused: list[str]) -> list[Line]:
    lines = []
    for number, line in enumerate(found.lines):
        xyz = to_map(layer, line.xyz, job.height_offset_m)
        if not np.isfinite(xyz[:, :2]).all():
            refused.append(
                f"line {number} ({line.kind}): its coordinates cannot be expressed in EPSG:{job.ground.srid}"
            )
            continue
        missing = np.isnan(xyz[:, 2])
        if missing.any():
            xyz[missing, 2] = geo.drape(xyz[missing, :2], job.ground)
        lines.append(line._replace(xyz=xyz))
    return lines


def _imported(
    file: store.BaseFile, kept: int | None, counts: store.BaseCounts, warnings: list[str], refusals: list[str]
) -> ImportedFile:
    """kept: None where another import of the file was faster."""
    if kept is None:
        return _unchanged(file, 0)
    read, refused = counts.read_count, counts.refused_count
    return ImportedFile(
        file.source_path, file.layer_name, file.kind, kept, read, refused, warnings=warnings, refusals=refusals
    )


def _unchanged(file: store.BaseFile, kept: int) -> ImportedFile:
    return ImportedFile(file.source_path, file.layer_name, file.kind, kept, unchanged=True)


def _sha256(path: Path) -> str:
    with input_errors(path):
        return file_sha256(path)
