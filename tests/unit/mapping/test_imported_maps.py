"""Features of an imported map against features that drives observed and missed."""

from __future__ import annotations

from uuid import UUID

import pytest

from conetl.mapping.deltas import ReconcileContext
from conetl.mapping.existence_update import MAX_LOG_ODDS, log_odds, missed, probability
from conetl.mapping.imported_maps import reconcile_imported
from conetl.model.map_records import DeltaKind, ImportedFeature, MapFeature
from conetl.model.params import ReconcileParams
from tests import records

PARAMS = ReconcileParams()


def cone(number: int, x_m: float, *, height_m: float = 0.5, exists: float = 0.9) -> MapFeature:
    here = records.standing_at((x_m, 0.0, 0.0), height_m, records.cov_of(0.1))
    return records.feature(
        number, seen_ns=0, last_seen_ns=0, object_height_sigma_m=0.01, existence_probability=exists, **here
    )


def deltas_of(imported, present, **options):
    statements = [ImportedFeature(feature=feature, valid_from_ns=5) for feature in imported]
    return {
        d.kind: d for d in reconcile_imported(statements, present, ReconcileContext(PARAMS, "k", **options), at_ns=9)
    }


def test_an_import_adds_to_the_probability_after_misses():
    """As for an observation, the prior is the probability after all misses; but an import is no drive that observed it."""
    feature = cone(1, 0.0)
    for before in (feature, missed(feature, 0.3, 4)):
        [delta] = deltas_of([cone(2, 0.05, exists=0.8)], [before]).values()
        assert delta.kind is DeltaKind.CONFIRMED
        wanted = probability(log_odds(before.existence_probability) + log_odds(0.8))
        assert delta.evidence.existence_probability == pytest.approx(wanted)
        assert delta.new.existence_probability == delta.evidence.existence_probability
        assert (delta.evidence.frames_seen, delta.evidence.frames_empty) == (0, 0)
        counts = (delta.new.seen_count, delta.new.missed_count, delta.new.first_missed_ns)
        assert counts == (feature.seen_count, before.missed_count, None)


def test_an_import_founds_confirms_moves_and_changes_heights_but_removes_nothing():
    present = [cone(1, 0.0), cone(2, 20.0), cone(3, 40.0), cone(4, 60.0)]
    imported = [cone(1, 2.0), cone(12, 20.05), cone(13, 40.0, height_m=1.0), cone(15, 80.0, exists=1.0)]
    found = deltas_of(imported, present)
    assert {kind: delta.feature_id.int for kind, delta in found.items()} == {
        DeltaKind.MOVED: 1,
        DeltaKind.CONFIRMED: 2,
        DeltaKind.HEIGHT_CHANGED: 3,
        DeltaKind.ADDED: 15,
    }
    assert found[DeltaKind.HEIGHT_CHANGED].new.object_height_m == 1.0
    assert found[DeltaKind.ADDED].new.existence_probability == pytest.approx(probability(MAX_LOG_ODDS))
    held = deltas_of(imported, present, pinned={UUID(int=1), UUID(int=3)})
    assert set(held) == {DeltaKind.CONFIRMED, DeltaKind.ADDED}
