"""The median and the closed forms that adjustments take instead of the general ones."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from conetl.geometry.medians import median
from conetl.geometry.motion.stereo_motion import inverse_of_symmetric


@given(st.lists(st.floats(-1e6, 1e6), min_size=1, max_size=40))
def test_it_is_numpys_median(values: list[float]) -> None:
    assert median(np.array(values)) == np.median(values)


def test_inverses_are_those_of_linear_algebra() -> None:
    rng = np.random.default_rng(3)
    factors = rng.normal(size=(50, 3, 3))
    matrices = factors @ np.swapaxes(factors, 1, 2) + 0.1 * np.eye(3)
    found = inverse_of_symmetric(np.ascontiguousarray(matrices.transpose(1, 2, 0))).transpose(2, 0, 1)
    np.testing.assert_allclose(found, np.linalg.inv(matrices), rtol=1e-9, atol=1e-12)
