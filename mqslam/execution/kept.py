"""The kinds of results that a checkpoint keeps, each with the functions that convert it to named arrays and back."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import astuple, dataclass, fields
from functools import partial
from typing import Any, Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from mqslam.core.measurement import Loop, LoopSearch, Measured, Measurement, Refined, Status
from mqslam.core.scans import PeakCounts, Returns
from mqslam.core.velocity import Detected, Velocities
from mqslam.errors import DataError

R = TypeVar("R")
Arrays = dict[str, NDArray[Any]]

_VELOCITIES = {field.name: f"velocity_{field.name}" for field in fields(Velocities)}  # names of arrays by names of fields
_LISTED: dict[str, type[Any]] = {"measurements": Measurement, "loops": Loop, "ties": Loop}  # fields that are lists


@dataclass(frozen=True)
class Kept(Generic[R]):
    """A kind of result that a checkpoint keeps.

    Args:
        file: name of the file that holds the result.
        pack: converts the result to arrays by name.
        unpack: restores the result from these arrays; raises KeyError if an array is missing.
    """

    file: str
    pack: Callable[[R], Arrays]
    unpack: Callable[[Arrays], R]


def describe_kept_stretch(begin: int, end: int) -> Kept[Detected]:
    """Returns the kind of result for the returns and the velocities found in the polar scans begin <= k < end."""
    return Kept(f"returns-{begin:06d}-{end:06d}.npz", _pack_detected, _unpack_detected)


def _pack_detected(detected: Detected) -> Arrays:
    """Converts a detection's result to arrays; the returns of all scans are joined, and `ends` says where each ends."""
    arrays = {name: np.concatenate([getattr(r, name) for r in detected.returns]) for name in _list_fields(Returns)}
    arrays["ends"] = np.cumsum([len(r) for r in detected.returns])
    arrays["counts"] = np.array(astuple(detected.counts), dtype=np.int64)
    arrays["unread"] = np.array(list(detected.unread), dtype=np.int64)
    why = [(str(error.path), error.problem, error.remedy) for error in detected.unread.values()]
    arrays["why"] = np.array(why, dtype=np.str_).reshape(-1, 3)
    for field, name in _VELOCITIES.items():
        arrays[name] = np.empty(0) if detected.velocities is None else np.asarray(getattr(detected.velocities, field))
    return arrays


def _unpack_detected(arrays: Arrays) -> Detected:
    """Restores a detection's result from the arrays of `_pack_detected`; computing times are not kept and become 0."""
    columns = [np.split(arrays[name], arrays["ends"][:-1]) for name in _list_fields(Returns)]
    returns = [Returns(*(np.ascontiguousarray(part) for part in parts)) for parts in zip(*columns, strict=True)]
    errors = (DataError(*words) for words in arrays["why"].tolist())
    unread = dict(zip(arrays["unread"].tolist(), errors, strict=True))
    own = {field: arrays[name] for field, name in _VELOCITIES.items()}
    velocities = Velocities(**own) if own["times"].size else None
    return Detected(returns, unread, counts=PeakCounts(*arrays["counts"].tolist()), velocities=velocities)


def _pack(result: object) -> Arrays:
    """Converts a dataclass of numbers and of lists of measurements or loops to arrays; None becomes NaN."""
    arrays: Arrays = {}
    for name in _list_fields(type(result)):
        value = getattr(result, name)
        if name in _LISTED:
            arrays |= {f"{name}.{key}": column for key, column in _stack(_LISTED[name], value).items()}
        else:
            arrays[name] = np.array(np.nan if value is None else value)
    return arrays


def _unpack(kind: type[R], arrays: Arrays) -> R:
    """Restores a dataclass from the arrays of `_pack`."""
    values: list[Any] = []
    for name in _list_fields(kind):
        if name in _LISTED:
            values.append(_split(_LISTED[name], arrays, f"{name}."))
        else:
            number = arrays[name].item()
            values.append(None if number != number else number)
    return kind(*values)


def _stack(kind: type, results: Sequence[object]) -> Arrays:
    """Converts results, all of one dataclass, to arrays: one per field, with one entry per result."""
    return {name: np.array([getattr(result, name) for result in results]) for name in _list_fields(kind)}


def _split(kind: type[R], arrays: Arrays, prefix: str = "") -> list[R]:
    """Restores results of a dataclass from the arrays of `_stack`, whose names in `arrays` begin with a prefix."""
    named = {name: arrays[f"{prefix}{name}"] for name in _list_fields(kind)}
    columns = {name: array if array.ndim > 1 else array.tolist() for name, array in named.items()}
    if "status" in columns:
        columns["status"] = [Status(word) for word in columns["status"]]
    return [kind(*row) for row in zip(*columns.values(), strict=True)]


def _list_fields(kind: type) -> list[str]:
    """Returns the names of a dataclass's fields."""
    return [f.name for f in fields(kind)]


MEASURED = Kept[Measured]("measurements.npz", _pack, partial(_unpack, Measured))
ALONG = Kept[list[Loop]]("along.npz", partial(_stack, Loop), partial(_split, Loop))
LOOPS = Kept[LoopSearch]("loops.npz", _pack, partial(_unpack, LoopSearch))
REFINED = Kept[Refined]("refinement.npz", _pack, partial(_unpack, Refined))
