"""Parameters of tests that take long for each of them."""

from __future__ import annotations

from collections.abc import Collection, Iterable
from typing import Any

import pytest


def mostly_slow(values: Iterable[Any], fast: Collection[Any]) -> list[Any]:
    """Marks all parameters of a test as slow but a few, which show the behaviour in `make test`.

    Args:
        values: all parameters; tuples are the values of several names.
        fast: those of them that `make test` runs.

    Raises:
        ValueError: one of the fast is no parameter.
    """
    values = list(values)
    if unknown := [value for value in fast if value not in values]:
        raise ValueError(f"no such parameters: {unknown}")
    return [value if value in fast else _slow(value) for value in values]


def _slow(value: Any) -> Any:
    values = value if isinstance(value, tuple) else (value,)
    return pytest.param(*values, marks=pytest.mark.slow)
