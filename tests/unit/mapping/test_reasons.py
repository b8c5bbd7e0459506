"""The sentence that says why a feature changed."""

from __future__ import annotations

from uuid import UUID

import pytest

from conetl.mapping.reasons import ChangeFacts, explain_change, length_text, probability_text, sure_text
from conetl.model.map_records import DeltaKind

OTHER = UUID("0123abcd-0000-0000-0000-000000000000")
SEEN = {"frames_seen": 12, "range_m": (6.2, 29.6), "sigma_m": 0.0214}
SEEN_TEXT = "drive x observed it in 12 frame pairs at 6–30 m"


@pytest.mark.parametrize(
    ("kind", "existence", "facts", "sentence"),
    [
        ("added", 0.98, SEEN, f"Added: {SEEN_TEXT}; sure it stands: 98 %, accuracy ±2 cm."),
        ("added", 0.5, {}, "Added: drive x observed it; sure it stands: 50 %."),
        ("confirmed", 0.9991, {**SEEN, "frames_seen": 1, "range_m": (9.1, 9.4)},
         "Confirmed: drive x observed it in 1 frame pair at 9 m; sure it stands: >99 %, accuracy ±2 cm."),
        ("moved", 0.9, {**SEEN, "shift_m": 1.5},
         f"Moved: {SEEN_TEXT}, 1.50 m from its earlier position; sure it stands: 90 %, accuracy ±2 cm."),
        ("removed", 0.02, {"frames_seen": 0, "frames_empty": 14, "range_m": (6, 30), "sigma_m": 0.02},
         "Removed: drive x passed at 6–30 m, the position was visible in 14 frame pairs, none showed a cone; "
         "sure it stands: 2 %."),
        ("missed", 0.71, {"frames_seen": 1, "frames_empty": 3},
         "Not observed: drive x passed, the position was visible in 4 frame pairs, 1 of them showed a cone; "
         "sure it stands: 71 %, it stays on the map."),
        ("missed", 0.71, {}, "Not observed: drive x passed, the position was visible, no cone was observed; "
         "sure it stands: 71 %, it stays on the map."),
        ("height_changed", 0.9, {**SEEN, "object_height_m": 0.51, "sigma_m": None},
         f"Height changed: {SEEN_TEXT}, as a cone 0.51 m high; sure it stands: 90 %."),
        ("split", 0.9, {**SEEN, "sigma_m": None, "other_feature_id": OTHER},
         f"Split: {SEEN_TEXT}, as a second cone beside 0123abcd; sure it stands: 90 %."),
        ("merged", 0.001, {"other_feature_id": OTHER},
         "Merged: drive x observed one cone where the map had two; 0123abcd remains; sure it stands: <1 %."),
        ("added", 0.9, {"is_import": True, "sigma_m": 0.1},
         "Added: the imported map x states it; sure it stands: 90 %, accuracy ±10 cm."),
    ],
)  # fmt: skip
def test_a_sentence_with_numbers_for_each_kind(kind, existence, facts, sentence):
    assert explain_change(ChangeFacts(DeltaKind(kind), "x", existence, **facts)) == sentence


@pytest.mark.parametrize(
    ("value", "text"),
    [(0.0, "<0.001"), (0.0004, "<0.001"), (0.0006, "0.001"), (0.97, "0.970"), (0.9994, "0.999"), (0.9995, ">0.999")],
)
def test_a_probability_never_reads_as_certain(value, text):
    assert probability_text(value) == text


def test_every_kind_has_a_sentence_without_any_number_stored():
    for kind in DeltaKind:
        assert explain_change(ChangeFacts(kind, "x", 0.5)).endswith(".")


def test_words_for_everybody():
    assert [sure_text(p) for p in (0.0, 0.0049, 0.32, 0.9949, 0.995, 1.0)] == [
        "<1 %",
        "<1 %",
        "32 %",
        "99 %",
        ">99 %",
        ">99 %",
    ]
    assert [length_text(m) for m in (0.004, 0.0094, 0.0096, 0.03, 0.99, 1.24)] == [
        "4 mm",
        "9 mm",
        "1 cm",
        "3 cm",
        "99 cm",
        "1.2 m",
    ]
