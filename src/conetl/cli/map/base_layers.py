"""`conetl base`: base layers of the map, LiDAR points and lane boundaries for the browser and QGIS."""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from conetl.cli import console as ui
from conetl.cli.database import open_map
from conetl.db.base_store import drop_base_layer, list_base_sources, read_map_ground
from conetl.model.errors import EXIT_BAD_INPUT, EXIT_NEEDS_ATTENTION, InputError

if TYPE_CHECKING:  # GDAL and the LAS libraries take seconds to load: only where a file is imported
    from conetl.pipeline.maps.import_base_layer import ImportedFile

_LAYER_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9 ._-]{0,59}")
_SHOWN_REFUSALS = 5
#: Exit code 1 if a larger share of points or lines was rejected.
_MAX_REFUSED_SHARE = 0.1


def import_files(
    files: Annotated[
        list[Path],
        typer.Argument(
            help="Points: LAS, LAZ, COPC, or a drive folder with velodyne_points. Lines: Lanelet2 (.osm), GeoJSON, GeoPackage, "
            "OpenDRIVE (.xodr)."
        ),
    ],
    kind: Annotated[Literal["points", "lines"] | None, typer.Option(help="Only accept files of this kind.")] = None,
    crs: Annotated[
        str | None,
        typer.Option(help="CRS of the files, e.g. EPSG:25832, if they contain none or a wrong one."),
    ] = None,
    layer: Annotated[str | None, typer.Option(help="Name of the layer; default: the file name.")] = None,
    voxel: Annotated[
        float, typer.Option(min=0.01, max=10.0, help="Keep one point per cube of this size, in metres.")
    ] = 0.05,
    height_offset: Annotated[
        float,
        typer.Option(min=-10_000, max=10_000, help="Metres to add to all heights, e.g. the geoid undulation."),
    ] = 0.0,
    map_name: ui.MapOption = None,
    as_json: ui.JsonOption = False,
) -> None:
    """Import files as base layers. A changed file replaces its earlier version; an unchanged one is skipped."""
    done: list[ImportedFile] = []
    failed = False
    for path in files:
        try:
            imported = import_one(
                map_name, path, kind=kind, crs=crs, layer=layer, voxel_m=voxel, height_offset_m=height_offset
            )
        except InputError as error:
            ui.complain(error)
            failed = True
        else:
            done.append(imported)
            if not as_json:
                print_imported(imported)
    if as_json:
        ui.print_json(done)
    if failed:
        raise typer.Exit(EXIT_BAD_INPUT)
    if any(item.refused > _MAX_REFUSED_SHARE * item.read for item in done):
        raise typer.Exit(EXIT_NEEDS_ATTENTION)


def import_one(
    map_name: str | None, path: Path, *, kind: str | None = None, crs: str | None = None, layer: str | None = None,
    voxel_m: float = 0.05, height_offset_m: float = 0.0,
) -> ImportedFile:  # fmt: skip
    """Import one file into the map of this name, or of the settings. Raises InputError; then nothing was written."""
    from conetl.pipeline.maps.import_base_layer import FileImport, import_file, kind_of

    if path.exists() and kind is not None and kind_of(path) != kind:
        raise InputError(f"{path}: contains {kind_of(path)}, not {kind}")
    name = layer if layer is not None else _name_of(path)
    if not _LAYER_NAME.fullmatch(name):
        raise InputError(f"--layer {name!r}: a name has 1 to 60 letters, digits, spaces, dots, dashes or underscores")
    unit = "scans" if path.is_dir() else "points"
    with open_map(map_name) as (conn, info), ui.progress_bar(path.name, unit) as update:
        ground = read_map_ground(conn, info.map_name, info.srid)
        return import_file(FileImport(conn, path, ground, info.map_name, name, crs, voxel_m, height_offset_m, update))


def print_imported(item: ImportedFile) -> None:
    """The result for one file."""
    for warning in item.warnings:
        ui.note(warning)
    if item.unchanged:
        ui.say(f"{item.file}: already in layer {item.layer}, unchanged")
        return
    of = f" of {item.read:,}" if item.read != item.kept else ""
    ui.say(f"{item.file} -> layer {item.layer}: {item.kept:,}{of} {item.kind}")
    for refusal in item.refusals[:_SHOWN_REFUSALS]:
        ui.say(f"  not used: {refusal}")
    if len(item.refusals) > _SHOWN_REFUSALS:
        ui.say(f"  not used: {len(item.refusals) - _SHOWN_REFUSALS} more")


_COLUMNS: ui.Columns = {
    "layer": "layer_name",
    "kind": "kind",
    "file": lambda s: Path(s["source_path"]).name,
    "CRS": "source_crs",
    "kept": lambda s: f"{s['kept_count']:,}",
    "read": lambda s: f"{s['read_count']:,}",
    "rejected": lambda s: f"{s['refused_count']:,}",
    "extent m": lambda s: f"{s['east_m'] - s['west_m']:.0f} x {s['north_m'] - s['south_m']:.0f}",
    "MB": lambda s: f"{s['bytes'] / 1e6:.1f}" if s["kind"] == "points" else "",
    "heights": "heights",
    "imported (UTC)": lambda s: f"{s['imported_at']:%Y-%m-%d %H:%M}",
}


def list_layers(map_name: ui.MapOption = None, as_json: ui.JsonOption = False) -> None:
    """List the base layers of the map and their files."""
    with open_map(map_name) as (conn, info):
        found = list_base_sources(conn, info.map_name)
    if as_json:
        ui.print_json(found)
    elif found:
        ui.print_records("", _COLUMNS, found, numbers_from=4)
    else:
        ui.say(f"The map {info.map_name} has no base layers: `conetl base import FILE` adds one.")


def drop(
    layer: Annotated[str, typer.Argument(help="Name of the layer.")],
    map_name: ui.MapOption = None,
    as_json: ui.JsonOption = False,
) -> None:
    """Remove a base layer and its data. Cones and their history are kept."""
    with open_map(map_name) as (conn, info):
        dropped = drop_base_layer(conn, info.map_name, layer)
    if not dropped:
        raise InputError(f"the map {info.map_name} has no base layer {layer}: see `conetl base list`")
    facts = {"layer": layer, "files": len(dropped)}
    ui.answer(as_json, facts, f"Removed layer {layer} with {ui.counted(len(dropped), 'file')}.")


def _name_of(path: Path) -> str:
    stem = (path.resolve().name if path.is_dir() else path.name.split(".")[0]) or "layer"
    return re.sub(r"[^A-Za-z0-9 ._-]", "-", stem)[:60].lstrip(" ._-") or "layer"
