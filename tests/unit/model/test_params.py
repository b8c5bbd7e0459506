from __future__ import annotations

from conetl.model.params import DetectionParams, IngestParams, params_sha256


def test_equal_parameters_have_equal_hashes_and_others_do_not() -> None:
    one = IngestParams(detection=DetectionParams(score_threshold=0.4))
    assert params_sha256(one) == params_sha256(IngestParams.model_validate({"detection": {"score_threshold": 0.4}}))
    assert params_sha256(one) != params_sha256(IngestParams())
