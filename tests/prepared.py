"""Functions of one value whose other arguments are given beforehand, for tables of cases."""

from __future__ import annotations

from collections.abc import Callable
from typing import Concatenate, ParamSpec, TypeVar

First = TypeVar("First")
Result = TypeVar("Result")
Others = ParamSpec("Others")


def prepared(function: Callable[Concatenate[First, Others], Result]) -> Callable[Others, Callable[[First], Result]]:
    """Decorator: called with the other arguments, the function waits for its first one."""
    return lambda *others, **named: lambda first: function(first, *others, **named)
