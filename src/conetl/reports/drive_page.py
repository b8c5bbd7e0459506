"""The page of one drive, written by its ingest and on demand, from the database alone; with images of each changed cone."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, NamedTuple
from uuid import UUID

import numpy as np
from markupsafe import Markup

from conetl.db.connection import Connection, read
from conetl.db.map.results import CommittedChangeset
from conetl.files.atomic import atomic_files
from conetl.mapping.visibility import DriveObservations, observations_of_drive, pairs_in_view
from conetl.model.base import utc_from_ns
from conetl.model.errors import StorageError
from conetl.model.health import Verdict, hold_remedy
from conetl.model.map_records import DeltaKind
from conetl.model.params import ReconcileParams
from conetl.model.rig import SIDES, Rig
from conetl.perception.images import ImageFileError
from conetl.reports import figures
from conetl.reports.camera_images import SURROUNDINGS, ImageMissingError, crop_jpeg, image_file
from conetl.reports.drive_facts import MAX_ILLUSTRATED, DriveFacts, Row, read_drive_facts
from conetl.reports.figures import counted_by_kind
from conetl.reports.html import data_uri, render, write_page
from conetl.reports.map_picture import PlanContent, draw_plan

#: A median residual above this is suspicious: the rays of a good calibration meet within half a pixel.
_RESIDUAL_PX = 1.0
_SIGMA_M = 0.5
_DOUBTFUL = 0.9
#: Confirmed cones in the table.
_MAX_CONFIRMED = 400
_NORMAL_TRAJECTORIES = {"refined", "switched_off"}
_NORMAL_CALIBRATIONS = {"insignificant", "no_estimate", "switched_off"}
_UNREAD = "The sightings cannot be read"


class Alert(NamedTuple):
    """Something that a person should review."""

    serious: bool
    text: str


def write_drive_page(
    conn: Connection, changeset: CommittedChangeset, path: Path, *, map_name: str, plan_path: Path | None = None
) -> Path:
    """Write the page of one changeset. Returns its path. Raises InputError for an imported map and where it cannot be written.

    plan_path: also write its plan there, as PNG.
    """
    page, plan = drive_page(conn, changeset, map_name=map_name)
    if plan_path is not None:
        with atomic_files(plan_path) as (file,):
            file.write_bytes(plan)
    return write_page(path, page)


def drive_page(conn: Connection, changeset: CommittedChangeset, *, map_name: str) -> tuple[str, bytes]:
    """The page as text, and the plan on it as PNG."""
    facts = read_drive_facts(conn, changeset, map_name=map_name)
    confirmed = [c for c in facts.changes if c["kind"] is DeltaKind.CONFIRMED]
    marks = [figures.PlanMark(one.category, None, one.xyz_m[:2]) for one in facts.others]
    for c in facts.changes:
        old_xy_m, label = None, str(c["number"])
        if c["kind"] is DeltaKind.MOVED:
            old_xy_m, label = c["old_xyz_m"][:2], f"{label} ({c['shift_m']:.2f} m)"
        marks.append(figures.PlanMark(c["category"], c["kind"], c["xyz_m"][:2], old_xy_m, label))
    plan = figures.png(
        draw_plan(
            PlanContent(changeset.map_srid, marks, facts.markings, [facts.path_m], others=figures.NOT_EVALUATED),
            title=f"Drive {changeset.drive_id}, {utc_from_ns(changeset.captured_from_ns):%Y-%m-%d %H:%M} UTC",
            footer=f"map {map_name} · grid north · conetl",
        )
    )
    nearest = [(t.nearest_range_m, t.residual_rms_px) for t in facts.tracks]
    page = render(
        "drive.html.j2",
        title=f"Drive {changeset.drive_id}",
        made_at=datetime.now(UTC),
        facts=facts,
        changeset=changeset,
        alerts=alerts(facts),
        changed=[c for c in facts.changes if c["kind"] is not DeltaKind.CONFIRMED],
        images=images_of(conn, facts),
        max_illustrated=MAX_ILLUSTRATED,
        confirmed=confirmed[:_MAX_CONFIRMED],
        confirmed_left_out=max(len(confirmed) - _MAX_CONFIRMED, 0),
        plan=plan,
        markings=counted_by_kind(facts.markings),
        residual_figure=figures.residuals(facts.range_m, facts.residual_px, nearest)
        if len(facts.residual_px)
        else None,
        residual_rows=_residual_rows(facts),
        number_of_track={c["track_index"]: c["number"] for c in facts.changes if c["track_index"] is not None},
        trajectory=_trajectory_rows(facts),
    )
    return page, plan


def alerts(facts: DriveFacts) -> list[Alert]:
    """What a person should review before using this drive, serious alerts first."""
    return sorted(_alerts(facts), key=lambda alert: not alert.serious)


def _hold_alerts(facts: DriveFacts) -> Iterator[Alert]:
    if not facts.changeset.counts:
        hold = facts.changeset.hold
        reason = "it was reverted, or replaced by a later analysis or delivery of the same recording."
        if hold:
            reason = f"the drive is on hold. {hold} {hold_remedy(facts.changeset.changeset_no, facts.map_name)}"
        yield Alert(True, f"This changeset is not in effect: {reason}")
    elif facts.hold_events and facts.hold_events[-1].what == "accepted":
        yield Alert(False, f"The drive was on hold, and was {facts.hold_events[-1].sentence}")


def _alerts(facts: DriveFacts) -> Iterator[Alert]:
    kinds = facts.changeset.change_counts.points
    yield from _hold_alerts(facts)
    yield from (Alert(False, check.detail) for check in facts.checks if check.verdict is Verdict.NOTE)
    if lost := facts.changeset.lost_pairs:
        expected, limit = facts.changeset.expected_frame_count, facts.header["params"].get("max_rejected_fraction")
        share = lost / expected
        text = f"{lost} of {expected} frame pairs were lost ({share:.1%})."
        yield Alert(limit is not None and share > limit, text)
    gone = kinds[DeltaKind.REMOVED] + kinds[DeltaKind.MISSED]
    found = kinds[DeltaKind.CONFIRMED] + kinds[DeltaKind.MOVED]
    if gone > max(found, 3):
        yield Alert(True, f"{gone} {facts.noun}s of the map were not observed although visible, and only {found} were "
                          "observed. Possible causes: a closed road, another road, or a wrong trajectory.")  # fmt: skip
    elif missed := [c for c in facts.changes if c["kind"] is DeltaKind.MISSED]:
        yield Alert(
            False, f"{_counted(missed, facts)} not observed although visible, still on the map: {_numbers(missed)}."
        )
    if not facts.tracks:
        yield Alert(True, f"No {facts.noun} was found on this drive.")
    if len(facts.residual_px) and (middle := float(np.median(facts.residual_px))) > _RESIDUAL_PX:
        yield Alert(
            True, f"The median residual is {middle:.2f} px: check the calibration and the camera synchronisation."
        )
    if vague := [c for c in facts.changes if c["sigma_m"] > _SIGMA_M and not c["kind"].ends]:
        yield Alert(False, f"{_counted(vague, facts)} with a horizontal sigma above {_SIGMA_M} m: {_numbers(vague)}.")
    if doubtful := [c for c in facts.changes if c["kind"].founds and c["existence_probability"] < _DOUBTFUL]:
        yield Alert(
            False,
            f"{_counted(doubtful, facts)} added with an existence probability below {_DOUBTFUL:g}: {_numbers(doubtful)}.",
        )
    if removed := [c for c in facts.changes if c["kind"] is DeltaKind.REMOVED]:
        yield Alert(False, f"{_counted(removed, facts)} removed from the map: {_numbers(removed)}. Check the images.")
    run = facts.header["facts"]
    if str(run.get("trajectory_outcome", "refined")) not in _NORMAL_TRAJECTORIES:
        yield Alert(False, f"The trajectory was not refined: {run.get('trajectory', '')}.")
    if str(run.get("calibration_outcome", "insignificant")) not in _NORMAL_CALIBRATIONS:
        yield Alert(False, f"Calibration: {run.get('calibration', '')}.")


def _counted(changes: Sequence[Row], facts: DriveFacts) -> str:
    return f"{len(changes)} {facts.noun}{'' if len(changes) == 1 else 's'}"


def _numbers(changes: Sequence[Row]) -> str:
    shown = ", ".join(str(c["number"]) for c in changes[:12])
    return f"no. {shown}" + (" ..." if len(changes) > 12 else "")


def _residual_rows(facts: DriveFacts) -> list[tuple[str, str, str, str, str]]:
    """(estimates, count, median, 95 %, largest) of positions near and far, and of cones."""
    residual_px, range_m = facts.residual_px, facts.range_m
    groups = [
        ("positions", residual_px),
        ("positions, 0 to 10 m", residual_px[range_m < 10.0]),
        ("positions, 10 to 20 m", residual_px[(range_m >= 10.0) & (range_m < 20.0)]),
        ("positions beyond 20 m", residual_px[range_m >= 20.0]),
        (f"{facts.noun}s (joint adjustment)", np.array([t.residual_rms_px for t in facts.tracks])),
    ]
    return [
        (name, str(len(v)), f"{np.median(v):.2f}", f"{np.percentile(v, 95):.2f}", f"{v.max():.2f}")
        for name, v in groups
        if len(v)
    ]


def _trajectory_rows(facts: DriveFacts) -> list[tuple[str, str]]:
    """Property and value of poses and calibration."""
    sigma = np.array([pair.pose.sigma_enu_m for pair in facts.frame_pairs])
    times_s = np.array([pair.captured_at_ns for pair in facts.frame_pairs]) * 1e-9
    steps_m, intervals_s = np.hypot(*np.diff(facts.path_m, axis=0).T), np.diff(times_s)
    horizontal = sigma[:, :2].max(axis=1)
    rows = [
        ("trajectory", str(facts.header["facts"].get("trajectory", "not stored"))),
        ("self-calibration", str(facts.header["facts"].get("calibration", "not stored"))),
        (
            "rig",
            f"{facts.rig.rig_id}: baseline {facts.rig.baseline_m:.3f} m, focal length {facts.rig.left.fx_px:.1f} px",
        ),
        ("horizontal sigma of the poses", f"median {np.median(horizontal):.3f} m, largest {horizontal.max():.3f} m"),
        ("vertical sigma of the poses", f"median {np.median(sigma[:, 2]):.3f} m, largest {sigma[:, 2].max():.3f} m"),
    ]
    if len(steps_m):
        speed = float((steps_m / np.maximum(intervals_s, 1e-3)).max())
        duration_s = times_s[-1] - times_s[0]
        rows.append(("distance", f"{steps_m.sum():.0f} m in {duration_s:.1f} s, at most {speed:.1f} m/s"))
        rows.append(("frame pairs", f"every {np.median(intervals_s):.3f} s, longest gap {intervals_s.max():.3f} s"))
    return rows


@dataclass(frozen=True)
class PairOfCrops:
    """Left and right crop with a title. Without crops, `missing` holds the reason."""

    title: str
    crops: tuple[Markup, ...]
    missing: str = ""


def images_of(conn: Connection, facts: DriveFacts) -> dict[int, list[PairOfCrops]]:
    """Pairs of crops, earlier ones first, by number of the change; of at most `MAX_ILLUSTRATED`, confirmations excluded."""
    shown = [change for change in facts.changes if change["kind"] is not DeltaKind.CONFIRMED][:MAX_ILLUSTRATED]
    drive = observations_of_drive(facts.rig, facts.frame_pairs, (), ())
    return {change["number"]: _of_change(conn, facts, change, drive) for change in shown}


def _of_change(conn: Connection, facts: DriveFacts, change: Row, drive: DriveObservations) -> list[PairOfCrops]:
    found: list[PairOfCrops] = []
    if not change["kind"].founds:
        before = {"feature_id": change["feature_id"], "before_ns": facts.changeset.captured_from_ns}
        for row in read(conn, _UNREAD, "reports.seen_before", **before)[:1]:
            title = f"before: {row['drive_id']}, {utc_from_ns(row['captured_from_ns']):%Y-%m-%d}"
            found.append(_sighting(conn, row["drive_uuid"], row["track_index"], title))
    if change["track_index"] is not None:
        found.append(_sighting(conn, facts.changeset.drive_uuid, change["track_index"], "this drive"))
    elif not facts.header["pruned_at"]:
        found.append(_expected(facts, change, drive))
    return found


def _sighting(conn: Connection, drive_uuid: UUID, track_index: int, title: str) -> PairOfCrops:
    """The nearest frame pair of a track."""
    rows = read(conn, _UNREAD, "reports.sighting", drive_uuid=drive_uuid, track_index=track_index)
    if not rows:
        return PairOfCrops(title, (), "its records were deleted")
    row = rows[0]
    title += f", frame pair {row['frame_index']}, {row['range_m']:.1f} m"
    boxes = [tuple(row[f"{side}_{name}_px"] for name in "xywh") for side in SIDES]
    paths = [row["left_path"], row["right_path"]]
    return _crops(title, row["source_path"], Rig.model_validate(row["rig"]), paths, boxes)


def _expected(facts: DriveFacts, change: Row, drive: DriveObservations) -> PairOfCrops:
    """The expected image of the object, in the pair where it is largest of those in which both images would contain it."""
    rows, heights_px, boxes = pairs_in_view(
        np.array(change["xyz_m"]), change["object_height_m"], drive, ReconcileParams(), change["category"]
    )
    if not len(rows):
        return PairOfCrops("this drive", (), "its position is not completely in view in any image pair")
    largest = int(heights_px[:, 0].argmax())
    pair = facts.frame_pairs[rows[largest]]
    title = f"this drive, frame pair {pair.frame_index}: expected position"
    shown = [(x0 + 0.5, y0 + 0.5, x1 - x0, y1 - y0) for x0, y0, x1, y1 in boxes[largest]]
    return _crops(title, facts.header["source_path"], facts.rig, [pair.left_path, pair.right_path], shown)


def _crops(title: str, source_path: str, rig: Rig, paths: Sequence[str], boxes: Sequence[Any]) -> PairOfCrops:
    try:
        crops = [
            data_uri(crop_jpeg(image_file(source_path, path), rig, side, box, context=SURROUNDINGS), "jpeg")
            for side, path, box in zip(SIDES, paths, boxes, strict=True)
        ]
    except (ImageMissingError, ImageFileError, StorageError, OSError) as error:
        return PairOfCrops(title, (), f"{Path(paths[0]).name}: {error}")
    return PairOfCrops(title, tuple(crops))
