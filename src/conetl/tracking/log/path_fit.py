"""Scale, alignment, lever arm and clock by which the path of a log differs from that of the images.

All are estimated together by generalised least squares (e.g. Koch 1999, ch. 3.2) with the model of the log's errors, so that what
a drive does not show has a large sigma, and errors of the log within its stated sigmas are significant for none of them. A drift
of the log at a constant rate is the same to the images as a wrong scale or alignment: where one is significant, the positions may
have drifted by it.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from conetl.geometry.motion.pose_graph import LoggedPoses, MeasuredMotions
from conetl.model.arrays import Bools, Floats
from conetl.model.params import TrajectoryParams
from conetl.tracking.log.log_errors import GROUPS, LogErrors, StatedErrors, compared_frames, difference_terms, log_cov
from conetl.tracking.log.path_difference import ASIDE, SCALE, UNKNOWN, UP, PathDifference, path_changes, path_difference

#: What is known beforehand of scale, direction (rad) and lever arm (m): one sigma; and of the clock (s) after its correction.
_PRIOR, _CLOCK_S = (0.1, 0.2, 0.2, 3.0, 3.0, 3.0), 0.005
#: So many frames show the turns of a drive; see `compared_frames`.
_MOST_FRAMES = 400
#: Share of the variance of a log's errors that may have the shape of another error.
_ALIKE = 1 / 3
#: A path is compared if its variance is so many times that of what the images err by.
_SHOWN = 10.0
#: Beyond this many sigmas of what is stated, and of the estimate, positions may have drifted.
_DOUBTFUL_SIGMAS, _SIGNIFICANT_SIGMAS = 2.0, 3.0


class PathFit(NamedTuple):
    """Estimates in the units of `path_changes`."""

    found: Floats
    """(7,)"""
    sigma: Floats
    """(7,) if the errors of the log have the spectrum that the drive shows."""
    sigma_of_any: Floats
    """(7,) if they may as well have any other, within their stated sigmas."""
    stated: Floats
    """(3,): stated sigmas of scale and of both directions."""
    prior: Floats
    """(7,) sigmas beforehand."""
    records: StatedErrors
    log_is_wrong: bool
    """Whether the log errs by more than it states: then the calibration need not be what differs."""
    difference: PathDifference
    changes: Floats
    """(K, 3, 7), see `path_changes`."""

    @property
    def scale(self) -> tuple[float, float]:
        """By what share the images show longer distances than the log, and its sigma."""
        return float(self.found[SCALE]), float(self.sigma[SCALE])

    @property
    def is_shown(self) -> bool:
        """Whether the path is more than what the images err by, unlike that of a vehicle that stands."""
        path_m, steps = self.difference.path_m, np.diff(self.difference.measured_var[:, :3], axis=0)
        noise = float(steps[steps < UNKNOWN / 2].sum())
        return float(np.square(path_m - path_m.mean(axis=0)).sum(axis=1).mean()) > _SHOWN * noise

    @property
    def doubtful(self) -> Bools:
        """(3,): whether neither calibration nor log, as they are stated, explain the scale, and the directions."""
        stated = 0.0 if self.log_is_wrong else _DOUBTFUL_SIGMAS * self.stated
        least = np.maximum(stated, _SIGNIFICANT_SIGMAS * self.sigma[:3])
        return np.asarray(np.abs(self.found[:3]) > least) & self.is_shown

    def drifts(self) -> Floats:
        """(K, 3, D) m: by how much positions may have drifted, from the first or to the last of them."""
        changes = (self.changes[:, :, :3] * self.found[:3])[:, :, self.doubtful]
        ends = changes[[0, -1]]
        constant = np.broadcast_to((ends[1] - ends[0]) / 2, changes.shape)
        return np.concatenate([constant, changes - ends.mean(axis=0)], axis=2)


def fit_path(
    log: LoggedPoses, rotations: Floats, positions: Floats | None, motions: MeasuredMotions, records: StatedErrors,
    errors: LogErrors, params: TrajectoryParams,
) -> PathFit:  # fmt: skip
    """rotations, positions, motions: as for `path_difference`. errors: of the log."""
    difference = path_difference(log, rotations, positions, motions, records.times_s, params)
    changes = path_changes(difference)
    prior = np.array([*_PRIOR, np.hypot(_CLOCK_S, params.clock_sigma_s)])  # a clock turns as a lever arm does
    found, cov = fitted_changes(difference, records, errors, changes, prior)
    stated = np.zeros(3)
    stated[SCALE] = params.scale_sigma
    stated[ASIDE], stated[UP] = (np.median(records.stated[:, axes].max(axis=1)) for axes in ((5,), (3, 4)))
    log_is_wrong = max(errors.horizontal.factor, errors.up.factor) > 1.0
    return PathFit(
        found,
        np.sqrt(np.diag(cov)),
        np.hypot(np.sqrt(np.diag(cov)), sigma_of_any_shape(records, changes, prior)),
        stated,
        prior,
        records,
        log_is_wrong,
        difference,
        changes,
    )


def sigma_of_any_shape(records: StatedErrors, changes: Floats, prior: Floats) -> Floats:
    """(C,): sigmas of changes (K, 3, C) if the errors of the log have just the shape of one of them.

    Of all errors whose mean square is the stated one, those that look most like what the log does not contain: a third of the
    variance may be so.
    """
    frames = compared_frames(records, _MOST_FRAMES)
    shapes = changes[frames] - changes[frames].mean(axis=0)
    shapes = (shapes / records.stated[frames, :3, None]).reshape(-1, len(prior))
    shown = shapes.T @ shapes / (_ALIKE * len(frames))
    return np.asarray(np.sqrt(np.diag(np.linalg.inv(shown + np.diag(prior**-2.0)))))


def fitted_changes(
    difference: PathDifference, records: StatedErrors, errors: LogErrors, changes: Floats, prior: Floats
) -> tuple[Floats, Floats]:
    """Generalised least squares of the difference of positions by changes (K, 3, C): (C,) and its covariance (C, C).

    errors: of the log. prior: (C,) sigmas.
    """
    frames = compared_frames(records, _MOST_FRAMES)
    normal, right = np.diag(prior**-2.0), np.zeros(len(prior))
    for group, axes in enumerate(GROUPS[:2]):
        for axis in axes:
            part = difference_terms(difference, records, frames, axis, None, group == 0)
            by = changes[frames, axis]
            solved = cho_solve(cho_factor(log_cov(part, errors[group])), np.column_stack([by, part.off]))
            normal += by.T @ solved[:, :-1]
            right += by.T @ solved[:, -1]
    cov = np.linalg.inv(normal)
    return np.asarray(cov @ right), np.asarray((cov + cov.T) / 2)
