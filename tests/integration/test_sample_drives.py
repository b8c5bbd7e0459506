"""The covariances of the sample drives hold: real images, detector, matching and adjustment, all three judged together."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from conetl.cli.tools.evaluate import analyse_folder
from conetl.evaluation.accuracy import PointErrors, members_of, pooled_consistency, position_errors
from conetl.evaluation.truth import compare_with_truth, read_truth_cones
from conetl.geometry.rig import map_SE3_left
from conetl.model.params import IngestParams
from conetl.pipeline.analysis import AnalysedDrive
from conetl.pipeline.settings import Settings
from conetl.tracking.positions import locate_positions
from conetl.tracking.variance_components import VarianceFactors, with_variance_factors

DRIVES = sorted((Path(__file__).resolve().parents[2] / "data" / "drives").iterdir())
PARAMS = IngestParams()


@pytest.fixture(scope="module")
def sightings(tmp_path_factory: pytest.TempPathFactory) -> dict[Path, AnalysedDrive]:
    """What the steps make of each drive."""
    settings = Settings(home=tmp_path_factory.mktemp("home"), workers=2)
    found = {}
    for drive in DRIVES:
        srid = read_truth_cones(drive / "truth.csv")[1]
        found[drive] = analyse_folder(drive, settings, PARAMS, map_srid=srid)
    return found


def errors_of(truth: Path, results: AnalysedDrive, factor: float) -> PointErrors:
    """Of single positions, with the sigmas of all image points multiplied by a factor."""
    drive = results.drive
    # What all sightings of a cone have in common of its disparity is a constant, which is not theirs to state.
    scaled = with_variance_factors(results.records.matches, VarianceFactors(factor**2, factor**2, factor**2))
    matches = [m.model_copy(update={"sigma_outline_px": factor * m.sigma_outline_px}) for m in scaled]
    pairs = {pair.frame_index: pair for pair in drive.frame_pairs}
    positions, _ = locate_positions(matches, pairs, drive.rig, PARAMS.position)
    path_m = np.array([map_SE3_left(pair.pose, drive.rig)[:3, 3] for pair in drive.frame_pairs])
    lines, _ = compare_with_truth(read_truth_cones(truth)[0], results.tracks, path_m)
    return position_errors(members_of(lines), positions, drive, results.poses)


@pytest.mark.parametrize(("factor", "holds"), [(0.5, False), (1.0, True), (2.0, False)])
def test_sigmas_of_three_drives_together(sightings: dict[Path, AnalysedDrive], factor: float, holds: bool) -> None:
    """In the 95 % band of the summed degrees of freedom, which sigmas of half or double size leave."""
    errors = [errors_of(drive / "truth.csv", results, factor) for drive, results in sightings.items()]
    together = pooled_consistency(errors)
    assert together is not None
    assert together.relative.dof > 1000
    assert together.relative.holds() is holds
    assert together.absolute.holds() is holds
    assert together.common.holds() is holds
