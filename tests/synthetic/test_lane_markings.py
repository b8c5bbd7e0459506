"""Lane markings of a part of a sample drive: found where the truth has them, once, and only where they are asked for."""

from __future__ import annotations

from pathlib import Path

import pytest

from conetl import analyse, read_drive
from conetl.cli.ingest import read_params
from conetl.evaluation.markings import TRUTH_FILE, compare_markings, marking_figures, read_truth_markings, visible_to
from conetl.model.drive import DriveRecords
from conetl.model.feature_classes import CONE, LANE_MARKING
from conetl.model.params import DetectionParams, IngestParams
from conetl.perception.markings import crossings
from conetl.pipeline import markings as steps
from conetl.pipeline.settings import Settings
from tests.integration.small_drives import SAMPLES

PAIRS = slice(8, 20)
FEW = slice(8, 11)


def _analysed(home: Path, *categories: str, pairs: slice = PAIRS) -> DriveRecords:
    drive, _ = read_drive(SAMPLES[0])
    part = drive.model_copy(update={"frame_pairs": drive.frame_pairs[pairs]})
    params = IngestParams(detection=DetectionParams(categories=categories))
    return analyse(part, params, settings=Settings(home=home)).records


def test_markings_of_a_drive_agree_with_the_truth_and_are_computed_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    found = _analysed(tmp_path, LANE_MARKING)
    assert not found.detections
    truth = read_truth_markings(SAMPLES[0] / TRUTH_FILE, found.drive.map_srid)
    errors = compare_markings(truth, [track.marking for track in found.markings], visible_to(found.drive))
    figures = marking_figures([errors])
    assert figures.completeness is not None
    assert figures.completeness > 0.85  # dashes begin and end where they do
    assert figures.correctness == 1.0
    assert figures.pattern_share == figures.colour_share == 1.0
    assert figures.lateral_median_m is not None
    assert figures.lateral_median_m < 0.03

    def refuse(*_: object) -> None:
        raise AssertionError("searched again")

    monkeypatch.setattr(steps, "find_points", refuse)
    assert _analysed(tmp_path, LANE_MARKING).markings == found.markings


def test_a_drive_is_searched_for_markings_only_where_they_are_asked_for(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*_: object) -> None:
        raise AssertionError("searched")

    monkeypatch.setattr(crossings, "find_road", refuse)
    assert not _analysed(tmp_path, CONE, pairs=FEW).markings


def test_all_classes_are_those_of_the_model_and_markings() -> None:
    settings = Settings()
    assert read_params(None, ["all"], settings).detection.categories[-1] == LANE_MARKING
    assert CONE in read_params(None, ["all"], settings).detection.categories
    assert read_params(None, [LANE_MARKING], settings).detection.categories == (LANE_MARKING,)
