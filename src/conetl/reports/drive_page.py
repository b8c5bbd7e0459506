"""The page of one drive: written by its ingest, and again whenever somebody asks, from the database alone."""

from __future__ import annotations

from collections import Counter
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from conetl.db.connection import Connection
from conetl.db.map.results import CommittedChangeset
from conetl.files.atomic import atomic_text_file
from conetl.model.map_records import DeltaKind
from conetl.reports import figures
from conetl.reports.drive_facts import Change, DriveFacts, read_drive_facts
from conetl.reports.evidence import MAX_ILLUSTRATED, images_of
from conetl.reports.render import data_uri, render

#: Above it a residual deserves a look: the rays of a sound calibration meet within half a pixel.
_RESIDUAL_PX = 1.0
_SIGMA_M = 0.5
_DOUBTFUL = 0.9
#: Confirmed cones in the table.
_MAX_CONFIRMED = 400
_TOLD_OUTCOMES = {"refined", "switched_off"}
_TOLD_CALIBRATIONS = {"insignificant", "no_estimate", "switched_off"}


class Finding(NamedTuple):
    """Something that a person should look at."""

    grave: bool
    text: str


def write_drive_page(conn: Connection, changeset: CommittedChangeset, path: Path, *, map_name: str) -> Path:
    """Write the page of one changeset; returns its path. Raises InputError for an imported map or where it cannot be written."""
    page = drive_page(conn, changeset, map_name=map_name)
    with atomic_text_file(path) as file:
        file.write(page)
    return path


def drive_page(conn: Connection, changeset: CommittedChangeset, *, map_name: str) -> str:
    """The page as text: one file that loads nothing."""
    facts = read_drive_facts(conn, changeset, map_name=map_name)
    changed = [c for c in facts.changes if not c.is_confirmation]
    confirmed = [c for c in facts.changes if c.is_confirmation]
    residual = facts.residual_px
    return render(
        "drive.html.j2",
        title=f"Drive {changeset.drive_id}",
        made_at=datetime.now(UTC),
        facts=facts,
        changeset=changeset,
        findings=findings(facts),
        counts=_counts(facts),
        kinds=[(kind, sum(c.kind is kind for c in facts.changes)) for kind in DeltaKind],
        changed=changed,
        images=images_of(conn, facts, facts.changes),
        max_illustrated=MAX_ILLUSTRATED,
        confirmed=confirmed[:_MAX_CONFIRMED],
        confirmed_left_out=max(len(confirmed) - _MAX_CONFIRMED, 0),
        plan=data_uri(figures.plan(facts.path_m, facts.changes, facts.others_m), "png"),
        residual_figure=_residual_figure(facts),
        residual_rows=_residual_rows(facts) if len(residual) else [],
        existence_figure=_existence_figure(facts),
        weakest=sorted(facts.tracks, key=lambda track: track.existence_probability)[:5],
        number_of_track={c.track_index: c.number for c in facts.changes if c.track_index is not None},
        timeline=data_uri(figures.timeline([(s.step, s.started_s, s.ended_s) for s in facts.steps]), "png")
        if facts.steps
        else None,
        trajectory=_trajectory_rows(facts),
        versions=_version_rows(facts),
    )


def findings(facts: DriveFacts) -> list[Finding]:
    """What a person should look at before this drive is believed, the grave ones first."""
    found: list[Finding] = []
    kinds = Counter(c.kind for c in facts.changes)
    if not facts.changeset.counts:
        found.append(
            Finding(True, "This changeset does not count: it was reverted, or the drive was analysed again since.")
        )
    if facts.lost_pairs:
        share = facts.lost_pairs / facts.expected_frame_count
        grave = facts.max_rejected_fraction is not None and share > facts.max_rejected_fraction
        found.append(
            Finding(grave, f"{facts.lost_pairs} of {facts.expected_frame_count} frame pairs were lost ({share:.1%}).")
        )
    gone, again = (
        kinds[DeltaKind.REMOVED] + kinds[DeltaKind.MISSED],
        kinds[DeltaKind.CONFIRMED] + kinds[DeltaKind.MOVED],
    )
    if gone > max(again, 3):
        found.append(
            Finding(True, f"{gone} cones of the map were looked for in vain and only {again} found again: a closed road, "
                          "another road, or a trajectory that is off.")
        )  # fmt: skip
    if not facts.tracks:
        found.append(Finding(True, "No cone was found on this drive."))
    if len(facts.residual_px) and (middle := float(np.median(facts.residual_px))) > _RESIDUAL_PX:
        found.append(
            Finding(True, f"The median residual is {middle:.2f} px: calibration or synchronisation of the cameras.")
        )
    vague = [c for c in facts.changes if c.sigma_m > _SIGMA_M and not c.kind.ends]
    if vague:
        found.append(
            Finding(False, f"{_cones(vague)} placed no better than {_SIGMA_M} m (1 sigma): {_numbers(vague)}.")
        )
    doubtful = [c for c in facts.changes if c.kind.founds and c.existence_probability < _DOUBTFUL]
    if doubtful:
        found.append(
            Finding(
                False,
                f"{_cones(doubtful)} new with an existence probability below {_DOUBTFUL:g}: {_numbers(doubtful)}.",
            )
        )
    if kinds[DeltaKind.REMOVED]:
        removed = [c for c in facts.changes if c.kind is DeltaKind.REMOVED]
        found.append(Finding(False, f"{_cones(removed)} removed from the map: {_numbers(removed)}; see the images."))
    if str(facts.facts.get("trajectory_outcome", "refined")) not in _TOLD_OUTCOMES:
        found.append(Finding(False, f"The trajectory is the logged one: {facts.facts.get('trajectory', '')}."))
    if str(facts.facts.get("calibration_outcome", "insignificant")) not in _TOLD_CALIBRATIONS:
        found.append(Finding(False, f"Calibration: {facts.facts.get('calibration', '')}."))
    return sorted(found, key=lambda finding: not finding.grave)


def _cones(changes: list[Change]) -> str:
    return "1 cone is" if len(changes) == 1 else f"{len(changes)} cones are"


def _numbers(changes: list[Change]) -> str:
    shown = ", ".join(str(c.number) for c in changes[:12])
    return f"no. {shown}" + (" ..." if len(changes) > 12 else "")


def _counts(facts: DriveFacts) -> list[tuple[str, int]]:
    c = facts.changeset
    return [
        ("frame pairs", c.frame_pair_count), ("lost pairs", facts.lost_pairs), ("detections", c.detection_count),
        ("stereo matches", c.match_count), ("positions", c.position_count), ("cones", c.track_count),
        ("refused records", c.rejection_count),
    ]  # fmt: skip


def _residual_figure(facts: DriveFacts) -> Any:
    if not len(facts.residual_px):
        return None
    tracks = [(t.nearest_range_m, t.residual_rms_px) for t in facts.tracks]
    return data_uri(figures.residuals(facts.range_m, facts.residual_px, tracks), "png")


def _residual_rows(facts: DriveFacts) -> list[tuple[str, str, str, str, str]]:
    """(what, count, median, 95 %, largest) of positions near and far, and of cones."""
    edges = [(0.0, 10.0), (10.0, 20.0), (20.0, np.inf)]
    groups = [("positions", facts.residual_px)]
    groups += [
        (f"positions, {low:g} to {high:g} m" if np.isfinite(high) else f"positions beyond {low:g} m",
         facts.residual_px[(facts.range_m >= low) & (facts.range_m < high)])
        for low, high in edges
    ]  # fmt: skip
    groups.append(("cones (joint adjustment)", np.array([t.residual_rms_px for t in facts.tracks])))
    return [
        (what, str(len(v)), f"{np.median(v):.2f}", f"{np.percentile(v, 95):.2f}", f"{v.max():.2f}")
        for what, v in groups
        if len(v)
    ]


def _existence_figure(facts: DriveFacts) -> Any:
    if not facts.tracks:
        return None
    probabilities = np.array([t.existence_probability for t in facts.tracks])
    return data_uri(figures.existence(probabilities, facts.min_existence_probability), "png")


def _trajectory_rows(facts: DriveFacts) -> list[tuple[str, str]]:
    """What is known of poses and calibration."""
    sigma = np.array([pair.pose.sigma_enu_m for pair in facts.frame_pairs])
    times_s = np.array([pair.captured_at_ns for pair in facts.frame_pairs]) * 1e-9
    steps_m = np.hypot(*np.diff(facts.path_m, axis=0).T)
    apart_s = np.diff(times_s)
    horizontal = np.maximum(sigma[:, 0], sigma[:, 1])
    rows = [
        ("trajectory", str(facts.facts.get("trajectory", "not kept"))),
        ("self-calibration", str(facts.facts.get("calibration", "not kept"))),
        ("rig", f"{facts.rig.rig_id}: base {facts.rig.baseline_m:.3f} m, focal length {facts.rig.left.fx_px:.1f} px"),
        ("horizontal sigma of the poses", f"median {np.median(horizontal):.3f} m, largest {horizontal.max():.3f} m"),
        ("vertical sigma", f"median {np.median(sigma[:, 2]):.3f} m, largest {sigma[:, 2].max():.3f} m"),
    ]
    if len(steps_m):
        fastest = float((steps_m / np.maximum(apart_s, 1e-3)).max())
        rows.append(("way", f"{steps_m.sum():.0f} m in {times_s[-1] - times_s[0]:.1f} s, fastest {fastest:.1f} m/s"))
        rows.append(("frame pairs", f"every {np.median(apart_s):.3f} s, longest gap {apart_s.max():.3f} s"))
    return rows


def _version_rows(facts: DriveFacts) -> list[tuple[str, str]]:
    c, kept = facts.changeset, facts.facts
    libraries = ", ".join(f"{name} {version}" for name, version in dict(kept.get("libraries", {})).items())
    return [
        ("conetl", c.code_version),
        ("code (SHA-256)", str(kept.get("code_sha256", "not kept"))),
        ("model (SHA-256)", c.model_sha256),
        ("parameters (SHA-256)", c.params_sha256),
        ("content of the drive (SHA-256)", facts.content_sha256),
        ("idempotency key", c.idempotency_key),
        ("changeset", str(c.changeset_id)),
        ("Python", str(kept.get("python", "not kept"))),
        ("libraries", libraries or "not kept"),
        ("drive folder", facts.source_path),
    ]
