"""Belief in a feature over drives: Bayes in log-odds, one term a drive.

A drive that sees the cone adds the log-odds that its track had, an imported map those that it states. A drive that looks at the
spot and does not see it adds the log-likelihood ratio of its empty frame pairs (`mapping/visibility.py`), but first allows for
the cone having been taken away since: no number of earlier sightings holds more than ln((1 - v) / v) against it, v the chance
that a cone vanishes from one drive to the next (a binary Bayes filter, Thrun, Burgard & Fox 2005, Probabilistic Robotics,
section 4.2, with that transition).
"""

from __future__ import annotations

from math import exp, log

from conetl.mapping.visibility import Look
from conetl.model.map_records import Doubt, MapFeature, SightingEvidence, Statement
from conetl.model.params import ReconcileParams
from conetl.model.records import Track, sound

#: Belief in a feature never becomes certainty: the next drive must be able to change it.
MAX_LOG_ODDS = 7.0
_EDGE = 1e-6


def seen(feature: MapFeature | None, doubt: Doubt | None, track: Track) -> SightingEvidence:
    """A drive saw the feature (None: for the first time) as `track`; doubt: what misses since its last version make of it."""
    return _for_it(feature, doubt, track.existence_probability, frames_seen=len({frame for frame, _ in track.members}))


def stated(feature: MapFeature | None, doubt: Doubt | None, statement: Statement) -> SightingEvidence:
    """An imported map says that the feature (None: a new one) stands there; arguments as of `seen`. Nobody looked."""
    return _for_it(feature, doubt, statement.feature.existence_probability, frames_seen=0)


def missed(feature: MapFeature, doubt: Doubt | None, look: Look, params: ReconcileParams) -> SightingEvidence:
    """A drive looked at the feature's spot and did not see it."""
    most = log_odds(1 - params.vanished_probability)
    after = min(log_odds(_believed(feature, doubt)), most) + look.log_likelihood_ratio
    return SightingEvidence(
        log_likelihood_ratio=look.log_likelihood_ratio,
        existence_probability=probability(max(after, -MAX_LOG_ODDS)),
        frames_seen=look.occupied,
        frames_empty=look.frames,
    )


def is_gone(evidence: SightingEvidence, params: ReconcileParams, *, moved: bool = False) -> bool:
    """Whether a miss is enough to remove the feature; moved: or to say that it is the new cone near it."""
    below = params.moved_existence_probability if moved else params.removal_existence_probability
    return evidence.frames_empty >= params.removal_min_frames and evidence.existence_probability < below


def doubt_after(doubt: Doubt | None, existence_probability: float, first_missed_ns: int) -> Doubt:
    """Doubt after one more miss."""
    first = first_missed_ns if doubt is None else min(doubt.first_missed_ns, first_missed_ns)
    return Doubt(existence_probability=existence_probability, first_missed_ns=first)


def log_odds(value: float) -> float:
    """ln p / (1 - p), kept finite."""
    p = min(max(value, _EDGE), 1 - _EDGE)
    return log(p / (1 - p))


def probability(log_odds_value: float) -> float:
    """The inverse of `log_odds`."""
    return 1 / (1 + exp(-log_odds_value))


def _for_it(
    feature: MapFeature | None, doubt: Doubt | None, existence_probability: float, *, frames_seen: int
) -> SightingEvidence:
    ratio = log_odds(existence_probability)
    before = 0.0 if feature is None else log_odds(_believed(feature, doubt))
    return sound(
        SightingEvidence,
        log_likelihood_ratio=ratio,
        existence_probability=probability(min(before + ratio, MAX_LOG_ODDS)),
        frames_seen=frames_seen,
        frames_empty=0,
    )


def _believed(feature: MapFeature, doubt: Doubt | None) -> float:
    return feature.existence_probability if doubt is None else doubt.existence_probability
