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
_STATUSES = tuple(Status)
_DOPPLER = ("doppler_beta", "doppler_sigma")
_COUNTS = ("tried", "ambiguous", "implausible", "unsure", "alike")  # fields of a search for loops that are counts


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


def _pack_measured(measured: Measured) -> Arrays:
    """Converts all measured motions and the Doppler shift to arrays, one per field of `Measurement` and two more."""
    doppler: Arrays = {name: np.array(getattr(measured, name)) for name in _DOPPLER}
    statuses = np.array([_STATUSES.index(motion.status) for motion in measured.measurements], dtype=np.uint8)
    return doppler | _stack(Measurement, measured.measurements) | {"status": statuses}


def _unpack_measured(arrays: Arrays) -> Measured:
    """Restores the measured motions and the Doppler shift from the arrays of `_pack_measured`."""
    statuses = np.array(_STATUSES, dtype=object)[arrays["status"]]
    motions = _split(Measurement, arrays | {"status": statuses})
    return Measured(motions, *(float(arrays[name]) for name in _DOPPLER))


def _pack_loops(search: LoopSearch) -> Arrays:
    """Converts the result of a search for loops to arrays: its counts, and the loops, one array per field."""
    counts: Arrays = {name: np.array(getattr(search, name)) for name in _COUNTS}
    return counts | _stack(Loop, search.loops)


def _unpack_loops(arrays: Arrays) -> LoopSearch:
    """Restores the result of a search for loops from the arrays of `_pack_loops`."""
    return LoopSearch(_split(Loop, arrays), *(int(arrays[name]) for name in _COUNTS))


def _pack_refined(refined: Refined) -> Arrays:
    """Converts a refinement to arrays: loops followed by ties, the number of loops, three values of psi, and `refused`."""
    psi = np.array([refined.psi_before, refined.psi_loops, refined.psi_across], dtype=np.float64)  # None becomes NaN
    own = {"staying": np.array(len(refined.loops)), "psi_across": psi, "refused": np.array(refined.refused)}
    return own | _stack(Loop, [*refined.loops, *refined.ties])


def _unpack_refined(arrays: Arrays) -> Refined:
    """Restores a refinement from the arrays of `_pack_refined`."""
    loops, staying = _split(Loop, arrays), int(arrays["staying"])
    before, closed, after = (None if np.isnan(value) else float(value) for value in arrays["psi_across"])
    return Refined(loops[:staying], loops[staying:], before, closed, after, bool(arrays["refused"]))


def _stack(kind: type, results: Sequence[object]) -> Arrays:
    """Converts results, all of one dataclass, to arrays: one per field, with one entry per result."""
    return {name: np.array([getattr(result, name) for result in results]) for name in _list_fields(kind)}


def _split(kind: type[R], arrays: Arrays) -> list[R]:
    """Restores results of a dataclass from the arrays of `_stack`."""
    named = (arrays[name] for name in _list_fields(kind))
    columns = (array if array.ndim > 1 else array.tolist() for array in named)
    return [kind(*row) for row in zip(*columns, strict=True)]


def _list_fields(kind: type) -> list[str]:
    """Returns the names of a dataclass's fields."""
    return [f.name for f in fields(kind)]


MEASURED = Kept("measurements.npz", _pack_measured, _unpack_measured)
ALONG = Kept[list[Loop]]("along.npz", partial(_stack, Loop), partial(_split, Loop))
LOOPS = Kept("loops.npz", _pack_loops, _unpack_loops)
REFINED = Kept("refinement.npz", _pack_refined, _unpack_refined)
