"""Existence probability of a feature over drives: a binary Bayes filter in log-odds, one term per drive.

A drive that observes the cone adds the log-odds of its track; an imported map adds those that it states. A drive to which the
location was visible but which did not observe the cone adds the log-likelihood ratio of its empty frame pairs (`visibility.py`).
Before that, the transition of the filter (Thrun, Burgard & Fox 2005, Probabilistic Robotics, section 4.2) limits the log-odds to
ln((1 - v) / v), v being the probability that a cone is removed between two drives.
"""

from __future__ import annotations

from math import exp, log
from typing import Any

from conetl.mapping.visibility import NotObserved
from conetl.model.drive import Track
from conetl.model.map_records import ExistenceEvidence, MapFeature
from conetl.model.params import ReconcileParams

#: Limit of the log-odds, so that later drives can still change them.
MAX_LOG_ODDS = 7.0
_EDGE = 1e-6


def sighting_evidence(feature: MapFeature | None, track: Track) -> ExistenceEvidence:
    """Evidence of a drive that observed the feature (None: a new one) as `track`."""
    return confirmation_evidence(feature, track.existence_probability, len({frame for frame, _ in track.members}))


def confirmation_evidence(
    feature: MapFeature | None, existence_probability: float, frames_seen: int
) -> ExistenceEvidence:
    """Evidence of a drive that observed the feature in some frame pairs, or of an imported map (0) that contains it."""
    ratio = log_odds(existence_probability)
    before = 0.0 if feature is None else log_odds(feature.existence_probability)
    return ExistenceEvidence(
        log_likelihood_ratio=ratio,
        existence_probability=probability(min(before + ratio, MAX_LOG_ODDS)),
        frames_seen=frames_seen,
        frames_empty=0,
    )


def miss_evidence(feature: MapFeature, absence: NotObserved, params: ReconcileParams) -> ExistenceEvidence:
    """Evidence of a drive that did not observe the feature although its location was visible."""
    limit = log_odds(1 - params.vanished_probability)
    after = min(log_odds(feature.existence_probability), limit) + absence.log_likelihood_ratio
    return ExistenceEvidence(
        log_likelihood_ratio=absence.log_likelihood_ratio,
        existence_probability=probability(max(after, -MAX_LOG_ODDS)),
        frames_seen=absence.occupied,
        frames_empty=absence.frames,
    )


def is_gone(evidence: ExistenceEvidence, params: ReconcileParams, *, moved: bool = False) -> bool:
    """Whether a miss is enough to remove the feature, or (moved) to accept a new cone nearby as the moved one."""
    below = params.moved_existence_probability if moved else params.removal_existence_probability
    return evidence.frames_empty >= params.removal_min_frames and evidence.existence_probability < below


def observed(feature: MapFeature | None, evidence: ExistenceEvidence) -> dict[str, Any]:
    """Evidence columns of a feature (None: a new one) after a drive, or an imported map, that observed it."""
    seen, missed = (0, 0) if feature is None else (feature.seen_count, feature.missed_count)
    return {
        "existence_probability": evidence.existence_probability,
        "seen_count": seen + (evidence.frames_seen > 0),  # imported maps have none
        "missed_count": missed,
        "first_missed_ns": None,
    }


def missed(feature: MapFeature, existence_probability: float, missed_ns: int) -> MapFeature:
    """A feature that stays on the map, after a drive that missed it."""
    first_ns = missed_ns if feature.first_missed_ns is None else min(feature.first_missed_ns, missed_ns)
    return feature.model_copy(
        update={
            "existence_probability": existence_probability,
            "missed_count": feature.missed_count + 1,
            "first_missed_ns": first_ns,
        }
    )


def ended(feature: MapFeature, evidence: ExistenceEvidence | None) -> MapFeature:
    """A feature that is gone: removed by a drive that missed it, or (evidence: None) merged into another one."""
    after: dict[str, Any] = {"version": feature.version + 1, "first_missed_ns": None}
    if evidence is not None:
        after |= {"existence_probability": evidence.existence_probability, "missed_count": feature.missed_count + 1}
    return feature.model_copy(update=after)


def log_odds(value: float) -> float:
    """ln p / (1 - p), kept finite."""
    p = min(max(value, _EDGE), 1 - _EDGE)
    return log(p / (1 - p))


def probability(log_odds_value: float) -> float:
    """Inverse of `log_odds`."""
    return 1 / (1 + exp(-log_odds_value))
