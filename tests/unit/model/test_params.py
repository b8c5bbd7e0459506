from __future__ import annotations

import pytest
from pydantic import ValidationError

from conetl.model.params import DetectionParams, IngestParams, params_sha256


def test_equal_parameters_have_equal_hashes_and_others_do_not() -> None:
    one = IngestParams(detection=DetectionParams(score_threshold=0.4))
    assert params_sha256(one) == params_sha256(IngestParams.model_validate({"detection": {"score_threshold": 0.4}}))
    assert params_sha256(one) != params_sha256(IngestParams())


def test_unknown_names_and_impossible_values_are_refused() -> None:
    with pytest.raises(ValidationError, match="Extra inputs"):
        IngestParams.model_validate({"detection": {"treshold": 0.4}})
    with pytest.raises(ValidationError):
        IngestParams.model_validate({"detection": {"score_threshold": 1.4}})
    with pytest.raises(ValidationError):
        IngestParams.model_validate({"position": {"max_range_m": float("nan")}})
