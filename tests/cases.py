"""Cases of one parametrized test: some run in `make test`, the others of their kind before a release (`make test-all`)."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import pytest


def cases(*always: Any, release: Iterable[Any]) -> list[Any]:
    """For `pytest.mark.parametrize` and parameters of fixtures; a case of several arguments is a tuple."""
    made = [(one if isinstance(one, tuple) else (one,), ()) for one in always]
    made += [(one if isinstance(one, tuple) else (one,), (pytest.mark.release,)) for one in release]
    return [pytest.param(*one, marks=marks) for one, marks in made]
