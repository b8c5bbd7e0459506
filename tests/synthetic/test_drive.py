"""Whole drives through the real steps in a world whose truth and noise are known: error bands on both sides."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest

from conetl.model.drive import FramePair, Track
from conetl.model.rejections import Rejection
from tests.synthetic.world import ORIGIN_M, Cone, detect, fuse_logged, locate, make_path, make_rig, shifted

TAPER = [Cone((14.0 + 5.0 * k, 3.6 - 0.5 * k, 0.0), height_m=0.7 if k % 2 else 0.5) for k in range(8)]
DENSE = [Cone((20.0 + 0.9 * k, 3.0 - 0.12 * k, 0.0)) for k in range(6)]
RIG = make_rig()


def fuse(
    cones: Sequence[Cone],
    true_pairs: Sequence[FramePair],
    logged_pairs: Sequence[FramePair] | None = None,
    *,
    noise_px: float = 0.7,
    drop: float = 0.0,
    seed: int = 1,
) -> tuple[list[Track], list[Rejection]]:
    """Tracks of a drive: images are taken from the true poses, everything else knows only the logged ones."""
    rng = np.random.default_rng(seed)
    logged = list(logged_pairs or true_pairs)
    detections = detect(cones, true_pairs, RIG, noise_px=noise_px, rng=rng)
    kept = {key: [d for d in found if rng.random() >= drop] for key, found in detections.items()}
    found, matches, positions = locate(kept, logged, RIG)
    return fuse_logged(logged, RIG, found, matches, positions)


def errors_m(tracks: Sequence[Track], cones: Sequence[Cone]) -> list[float]:
    """Distance of each cone to the nearest track."""
    feet = np.array([t.xyz_m for t in tracks]) - ORIGIN_M
    return [float(np.linalg.norm(feet - np.array(cone.foot_m), axis=1).min()) for cone in cones]


@pytest.mark.parametrize("cones", [TAPER, DENSE], ids=["taper", "dense"])
def test_every_cone_becomes_one_track(cones: list[Cone]) -> None:
    tracks, _ = fuse(cones, make_path(45))
    assert len(tracks) == len(cones)
    assert max(errors_m(tracks, cones)) < 0.25
    assert np.median(errors_m(tracks, cones)) < 0.1
    for track in tracks:
        foot_m = np.array(track.xyz_m) - ORIGIN_M
        cone = min(cones, key=lambda one: float(np.linalg.norm(foot_m - one.foot_m)))
        assert track.object_height_m == pytest.approx(cone.height_m, abs=0.05)


def test_missed_boxes_do_not_split_a_track() -> None:
    tracks, _ = fuse(TAPER, make_path(45), drop=0.2)
    assert len(tracks) == len(TAPER)


@pytest.mark.parametrize("cones", [TAPER, DENSE], ids=["taper", "dense"])
def test_a_sliding_trajectory_neither_doubles_nor_merges_cones(cones: list[Cone]) -> None:
    """As on the real street of the test data: for 20 frames the log advances 10 % less than the car, 2 m in all."""
    true_pairs = make_path(45, sigma_m=0.45)
    slide = np.clip(np.arange(45) - 12, 0, 20) * 0.1
    logged = [shifted(pair, (-float(s), 0.3 * float(s), 0.0)) for pair, s in zip(true_pairs, slide, strict=True)]
    tracks, _ = fuse(cones, true_pairs, logged)
    assert len(tracks) == len(cones)


def test_something_that_floats_or_is_too_tall_is_no_cone() -> None:
    sign = Cone((24.0, -3.0, 1.4), height_m=0.6)
    post = Cone((30.0, -3.5, 0.0), height_m=1.4)
    tracks, rejections = fuse([*TAPER, sign, post], make_path(45))
    assert len(tracks) == len(TAPER)
    assert {"not_on_ground", "height_implausible"} <= {str(r.reason) for r in rejections}


def test_weak_boxes_alone_make_no_cone() -> None:
    rng = np.random.default_rng(0)
    pairs = make_path(45)
    detections = detect(TAPER[:2], pairs, RIG, score=0.32, rng=rng)
    found, matches, positions = locate(detections, pairs, RIG)
    tracks, rejections = fuse_logged(pairs, RIG, found, matches, positions)
    assert tracks == []
    assert {str(r.reason) for r in rejections} == {"existence_unlikely"}
