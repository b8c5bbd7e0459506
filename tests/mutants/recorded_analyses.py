"""What analyses found of recordings, compared with what was recorded in `recorded/`: a changed constant or statistic is seen.

Renew an entry with CONETL_RENEW_RECORDED=1 and read the difference. Values may differ by a tenth of their sigma, or by 3 %: the
quantised network gives other scores on other processors.
"""

from __future__ import annotations

import json
import os
import re
from pathlib import Path
from typing import Any

import numpy as np

from conetl.pipeline.analysis import AnalysedDrive

FOLDER = Path(__file__).with_name("recorded")
_SHARE, _OF_SIGMA, _LEAST = 0.03, 0.1, 5e-4


def check_as_recorded(name: str, analysed: AnalysedDrive) -> None:
    """Raise AssertionError where the analysis of a recording differs from its record."""
    path = FOLDER / f"{re.sub(r'[^a-z0-9]+', '_', name.lower()).strip('_')}.json"
    found = _told(analysed)
    if os.environ.get("CONETL_RENEW_RECORDED"):
        FOLDER.mkdir(exist_ok=True)
        lines = (f" {json.dumps(key)}: {json.dumps(value)}" for key, value in found.items())
        path.write_text("{\n" + ",\n".join(lines) + "\n}\n", encoding="utf-8")
    known = json.loads(path.read_text(encoding="utf-8")) if path.exists() else {}
    apart = {
        key: (known.get(key), found.get(key)) for key in {**known, **found} if not _same(known.get(key), found.get(key))
    }
    assert apart == {}, f"{name}: recorded, found: {apart}"


def _told(analysed: AnalysedDrive) -> dict[str, Any]:
    """Checks, trajectory, calibration, model of the log's errors, tracks and counts; numbers to 4 digits."""
    trajectory, calibration, records = analysed.trajectory, analysed.calibration, analysed.records
    told: dict[str, Any] = {
        f"check {one.name}": [one.verdict, _pair(one.value, one.sigma), _rounded(one.limit), _words(one.detail)]
        for one in analysed.health
    }
    told["trajectory"] = [trajectory.outcome, _words(trajectory.detail), trajectory.changes]
    if trajectory.path is not None:
        told["path"] = [_pair(*both) for both in zip(trajectory.path.found, trajectory.path.sigma, strict=True)]
    if trajectory.clock is not None:
        told["clock"] = _pair(*trajectory.clock)
    for group, shares in trajectory.errors._asdict().items() if trajectory.errors is not None else ():
        # How long errors last, and whether they are slow or smooth, a drive hardly shows: rounding decides.
        parts = (shares.white, shares.fast, shares.slow + shares.smooth, shares.jitter_s, shares.factor)
        told[f"log {group}"] = [{"value": _rounded(part), "sigma": 0.2} for part in parts]
    told["calibration"] = [calibration.outcome, calibration.span_count]
    told["counts"] = [float(len(some)) for some in (records.rejections, records.matches, records.drive.frame_pairs)]
    for k, track in enumerate(records.tracks):
        sigmas = [cov[0] ** 0.5 for cov in (track.cov_m2, track.relative_cov_m2)] + [track.cov_m2[5] ** 0.5]
        place = [round(value, 3) for value in (*track.xyz_m, track.object_height_m)]
        told[f"track {k}"] = [
            track.category, place, [_rounded(value) for value in (*sigmas, track.object_height_sigma_m, track.nearest_range_m)],
            round(track.existence_probability, 3),
        ]  # fmt: skip
    return json.loads(json.dumps(told))  # as it is read again


def _rounded(value: float | None) -> float | None:
    return None if value is None else float(f"{value:.4g}")


def _pair(value: float | None, sigma: float | None) -> dict[str, float | None]:
    return {"value": _rounded(value), "sigma": _rounded(sigma)}


def _words(text: str) -> str:
    """A message without its numbers, which other processors may round up where this one rounds down."""
    return re.sub(r"-?\d+(?:[.,]\d+)*", "#", text)


def _same(one: Any, other: Any) -> bool:
    if isinstance(one, dict) and isinstance(other, dict):
        sigmas = [one.get("sigma"), other.get("sigma")]
        if None in sigmas or None in (one["value"], other["value"]):
            return one == other or (sigmas == [None, None] and _same(one["value"], other["value"]))
        near = abs(one["value"] - other["value"]) <= max(_OF_SIGMA * min(sigmas), _SHARE * abs(one["value"]))
        return near and _same(*sigmas)
    if isinstance(one, list) and isinstance(other, list):
        return len(one) == len(other) and all(map(_same, one, other))
    if isinstance(one, float) and isinstance(other, (int, float)) and abs(one) < 1e5:
        return bool(np.isclose(one, other, rtol=_SHARE, atol=_LEAST))
    if isinstance(one, float) and isinstance(other, float):
        return abs(one - other) <= 2e-3  # metres of a coordinate
    return bool(one == other)
