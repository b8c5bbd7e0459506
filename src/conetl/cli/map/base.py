"""`conetl base`: what the map lies on. LiDAR points and lane boundaries for the browser and for QGIS; cones are not touched."""

from __future__ import annotations

import re
from contextlib import closing
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from conetl.cli.console import JsonOption, complain, err, out, print_json, print_table, progress_bar
from conetl.cli.database import open_map
from conetl.db.base_store import drop_base_layer, list_base_sources, read_map_ground
from conetl.db.map.map_store import find_map
from conetl.model.errors import EXIT_BAD_INPUT, EXIT_TOO_MANY_REJECTIONS, InputError
from conetl.pipeline.settings import Settings, read_settings

if TYPE_CHECKING:  # GDAL and the LAS libraries take seconds to load: only where a file is imported
    from conetl.pipeline.import_base_layer import ImportedFile

app = typer.Typer(help="Base layers under the cones: LiDAR points and lane boundaries.", no_args_is_help=True)
_LAYER_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9 ._-]{0,59}")
_SHOWN_REFUSALS = 5
#: A larger share of refused points or lines is an exit code of its own.
_MAX_REFUSED_SHARE = 0.1


@app.command("import")
def import_files(
    files: Annotated[
        list[Path],
        typer.Argument(
            help="Points: LAS, LAZ, COPC, or a drive folder with velodyne_points. Lines: Lanelet2 (.osm), GeoJSON, GeoPackage, "
            "OpenDRIVE (.xodr)."
        ),
    ],
    kind: Annotated[
        str | None, typer.Option("--kind", help="points or lines: refuse files that hold the other.")
    ] = None,
    crs: Annotated[
        str | None,
        typer.Option("--crs", help="CRS of the files' coordinates, e.g. 25832, where they do not say or are wrong."),
    ] = None,
    layer: Annotated[str | None, typer.Option("--layer", help="Name of the layer; default the file's name.")] = None,
    voxel: Annotated[
        float,
        typer.Option(
            "--voxel", min=0.01, max=10.0, help="Points are thinned to one in a cube of this side, in metres."
        ),
    ] = 0.05,
    height_offset: Annotated[
        float,
        typer.Option("--height-offset", min=-10_000, max=10_000, help="Metres to add to heights, e.g. the geoid's."),
    ] = 0.0,
    as_json: JsonOption = False,
) -> None:
    """Put files under the map. The same file again changes nothing; a file that changed takes the place of its earlier state."""
    if kind not in (None, "points", "lines"):
        raise InputError(f"--kind {kind}: it is points or lines")
    settings = read_settings()
    done: list[ImportedFile] = []
    failed = False
    for path in files:
        try:
            done.append(
                import_one(
                    settings, path, kind=kind, crs=crs, layer=layer, voxel_m=voxel, height_offset_m=height_offset
                )
            )
        except InputError as error:
            complain(error)
            failed = True
        else:
            if not as_json:
                print_imported(done[-1])
    if as_json:
        print_json([asdict(item) for item in done])
    if failed:
        raise typer.Exit(EXIT_BAD_INPUT)
    if any(item.refused > _MAX_REFUSED_SHARE * item.read for item in done):
        raise typer.Exit(EXIT_TOO_MANY_REJECTIONS)


def import_one(
    settings: Settings, path: Path, *, kind: str | None = None, crs: str | None = None, layer: str | None = None,
    voxel_m: float = 0.05, height_offset_m: float = 0.0,
) -> ImportedFile:  # fmt: skip
    """Import one file into the map of the settings. Raises InputError, and then wrote nothing."""
    from conetl.pipeline.import_base_layer import ImportOptions, import_file, kind_of

    if path.exists() and kind is not None and kind_of(path) != kind:
        raise InputError(f"{path}: holds {kind_of(path)}, not {kind}")
    name = layer if layer is not None else _name_of(path)
    if not _LAYER_NAME.fullmatch(name):
        raise InputError(f"--layer {name!r}: a name is 1 to 60 letters, digits, spaces, dots, dashes or underscores")
    options = ImportOptions(settings.map_name, name, crs, voxel_m, height_offset_m)
    with closing(open_map(settings)) as conn, progress_bar() as bars:
        info = find_map(conn, settings.map_name)
        if info is None:
            raise InputError(f"there is no map {settings.map_name} to put {path} under: ingest a drive first")
        bar = bars.add_task(path.name, total=None)
        return import_file(
            conn, path, read_map_ground(conn, settings.map_name, info.srid), options,
            lambda so_far, total: bars.update(bar, completed=so_far, total=total),
        )  # fmt: skip


def print_imported(item: ImportedFile) -> None:
    """What became of one file, in a few lines."""
    for warning in item.warnings:
        err.print(f"[yellow]conetl: note:[/] {warning}".replace("[E", "\\[E"), soft_wrap=True)
    if item.unchanged:
        out.print(f"{item.file}: is in layer {item.layer} already, nothing changed", markup=False)
        return
    of = f" of {item.read:,}" if item.read != item.kept else ""
    out.print(f"{item.file} -> layer {item.layer}: {item.kept:,}{of} {item.kind}", markup=False)
    for refusal in item.refusals[:_SHOWN_REFUSALS]:
        out.print(f"  not used: {refusal}", markup=False)
    if len(item.refusals) > _SHOWN_REFUSALS:
        out.print(f"  not used: {len(item.refusals) - _SHOWN_REFUSALS} more", markup=False)


@app.command("list")
def list_layers(as_json: JsonOption = False) -> None:
    """The base layers of the map, file by file."""
    settings = read_settings()
    with closing(open_map(settings)) as conn:
        found = list_base_sources(conn, settings.map_name)
    if as_json:
        print_json([asdict(source) for source in found])
        return
    if not found:
        out.print(f"The map {settings.map_name} has no base layers: `conetl base import FILE` adds one.", markup=False)
        return
    rows = [
        (
            s.layer_name, s.kind, Path(s.source_path).name, s.source_crs, f"{s.kept_count:,}", f"{s.read_count:,}",
            f"{s.refused_count:,}",
            f"{s.east_m - s.west_m:.0f} x {s.north_m - s.south_m:.0f}", f"{s.bytes / 1e6:.1f}" if s.kind == "points" else "",
            s.heights,
            f"{s.imported_at:%Y-%m-%d %H:%M}",
        )
        for s in found
    ]  # fmt: skip
    columns = ("layer", "kind", "file", "CRS", "kept", "read", "refused", "extent m", "MB", "heights", "imported (UTC)")
    print_table("", columns, rows, numbers_from=4)


@app.command()
def drop(layer: Annotated[str, typer.Argument(help="Name of the layer.")], as_json: JsonOption = False) -> None:
    """Remove a base layer with all its files; cones and their history are not touched."""
    settings = read_settings()
    with closing(open_map(settings)) as conn:
        dropped = drop_base_layer(conn, settings.map_name, layer)
    if not dropped:
        raise InputError(f"the map {settings.map_name} has no base layer {layer}: `conetl base list` shows them")
    if as_json:
        print_json({"layer": layer, "files": len(dropped)})
    else:
        out.print(f"Layer {layer} is gone: {len(dropped)} file{'s' if len(dropped) > 1 else ''}.", markup=False)


def _name_of(path: Path) -> str:
    stem = (path.resolve().name if path.is_dir() else path.name.split(".")[0]) or "layer"
    return re.sub(r"[^A-Za-z0-9 ._-]", "-", stem)[:60].lstrip(" ._-") or "layer"
