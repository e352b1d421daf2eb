"""Finds the durations of a radar's turns from the stamps of polar scans and, if there are any, of azimuths.

A step is the time from the stamp of one polar scan to the stamp of the next; a gap is a step of more than one turn.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from mqslam.core.recording import FASTEST_TURN_US, SLOWEST_TURN_US
from mqslam.core.statistics import pick_evenly
from mqslam.formats.recordings.layout import Stamp

USUAL_TURN_US = 250_000  # duration of a turn [us] that is assumed where a recording shows none
# Number of successive steps whose median is the usual duration of a turn. With fewer steps, turns are measured one by one.
TURNS_AROUND = 9
LONGEST_STEP = 1.5  # a step longer than this many usual turns is a gap: at least half a turn is missing
ALIKE_TURNS = 1.25  # turns whose durations differ by less than this factor count as turns at the same rate
_FEWEST_AZIMUTHS = 8  # fewer azimuths do not show how fast the radar turned
# Quantile of the steps that counts as the duration of a turn in a recording of few polar scans. It is low, because polar
# scans may be missing but never come early.
_SHORT_SHARE = 0.25
_RATE_CELL = 1.1  # steps are counted together to find turn rates if their durations differ by less than this factor
_MOST_RATES = 8  # largest number of turn rates that a recording is assumed to have
_WHOLE_TURN = 0.2  # a step counts as a whole number of turns if it differs from that by at most this much [turns]
# Costs of the assumptions that explain a step: a polar scan is missing (the unit of costs), came late or came early, or the
# radar changed its rate.
_COST_MISSING, _COST_LATE, _COST_EARLY, _COST_RATE_CHANGE = 1.0, 1.5, 2.0, 4.0
_COMPARED_AZIMUTHS = 128  # largest number of azimuths of a polar scan that are compared to find how fast the radar turned
# Two azimuths are compared if at least this share of the polar scan's azimuths lies between them. The stamps of closer
# azimuths show the bursts in which a driver sends azimuths.
_COMPARED_APART = 0.25
Measure = Callable[[int], float | None]


def measure_turn(stamps_us: NDArray[np.float64], angles: NDArray[np.float64]) -> float | None:
    """Measures how long a whole turn takes [us], from the stamps and angles of azimuths.

    The duration is the median over pairs of azimuths that lie well apart. Bursts of stamps, missing azimuths and a few late
    stamps hardly change this median.

    Args:
        stamps_us: (A,) stamps of the azimuths [us], not decreasing, counted from any instant.
        angles: (A,) angles of the azimuths [rad], unwrapped.

    Returns:
        The duration, or None if there are too few azimuths, or if no radar turns so fast or so slowly.
    """
    if len(angles) < _FEWEST_AZIMUTHS:
        return None
    rows = pick_evenly(len(angles), _COMPARED_AZIMUTHS)
    stamps, turns = stamps_us[rows], angles[rows] / (2.0 * np.pi)
    first, second = np.triu_indices(len(rows), int(_COMPARED_APART * len(rows)))
    sweeps = np.abs(turns[second] - turns[first])
    moved = sweeps > 0.0
    if not moved.any():
        return None
    turn = float(np.median((stamps[second] - stamps[first])[moved] / sweeps[moved]))
    return turn if FASTEST_TURN_US <= turn <= SLOWEST_TURN_US else None


def find_usual_turns(stamps_us: NDArray[np.int64], measure: Measure | None = None) -> NDArray[np.float64]:
    """Finds the usual duration (N - 1,) of a turn [us] at each step from one polar scan to the next.

    The duration is found from the steps around each step, since a radar may change its rate. If there are few steps, or if
    polar scans are missing regularly, the steps alone do not show which of them are gaps; `measure` then shows it.

    Args:
        stamps_us: (N,) increasing stamps of the polar scans [us].
        measure: takes the index of a polar scan, and returns the duration [us] of its turn from the stamps of its azimuths,
            or None if these show no duration. Since a call may read the polar scan, all polar scans but the last are
            measured only if there are few, else one or two per turn rate. None if azimuths have no stamps.
    """
    usual = _find_usual_steps(np.diff(stamps_us).astype(np.float64))
    if measure is None or not len(usual):
        return usual
    if len(usual) < TURNS_AROUND:
        return np.array([measure(k) or step for k, step in enumerate(usual.tolist())])
    rates = np.round(np.log(usual / np.median(usual)) / np.log(ALIKE_TURNS))
    for rate in np.unique(rates):
        steps = np.flatnonzero(rates == rate)
        measured = [turn for k in _choose_examples(steps, len(usual)) if (turn := measure(k)) is not None]
        if measured and np.median(usual[steps]) > ALIKE_TURNS * np.median(measured):
            usual[steps] = np.median(measured)
    return usual


def place_turns(
    stamps_us: NDArray[np.int64], stamp: Stamp, usual_us: NDArray[np.float64]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Returns starts (N,) and durations (N,) [us] of a radar's turns, which have one stamp each.

    If stamps are starts, a turn lasts until the next stamp; if stamps are ends, a turn has lasted since the stamp before.
    Where the stamp after (or before) is missing or lies across a gap, the turn gets the duration of the next turn whose
    duration is known, or of the last such turn if none follows, since the rate changes slowly. If this duration is not close
    to the usual one, or no duration is known, the turn gets the usual duration.

    Args:
        stamps_us: (N,) increasing stamps of the turns [us].
        stamp: whether the stamps are starts or ends of turns.
        usual_us: (N - 1,) usual duration of a turn [us] at each step from one stamp to the next.
    """
    between = np.diff(stamps_us)
    if not len(between):
        durations = np.full(len(stamps_us), USUAL_TURN_US)
    else:
        whole = np.flatnonzero(between <= LONGEST_STEP * usual_us)
        own = np.arange(len(stamps_us)) - (stamp == "end")
        usual = usual_us[np.clip(own, 0, len(between) - 1)]
        durations = usual
        if len(whole):
            durations = between[whole[np.minimum(np.searchsorted(whole, own), len(whole) - 1)]]
            alone = ~np.isin(own, whole) & (np.abs(np.log(durations / usual)) > np.log(ALIKE_TURNS))
            durations = np.where(alone, usual, durations)
        durations = np.round(durations).astype(np.int64)
    return (stamps_us if stamp == "start" else stamps_us - durations), durations


def _find_usual_steps(steps: NDArray[np.float64]) -> NDArray[np.float64]:
    """Finds the usual duration (M,) of a turn [us] at each of M steps [us] from one polar scan to the next.

    If there are few steps, it is one of the shortest steps, since polar scans may be missing but never come early. Where the
    steps show no plausible duration, it is 250 ms.
    """
    if len(steps) >= TURNS_AROUND:
        usual = _explain_steps(steps)
    else:
        turns = np.sort(steps[(steps >= FASTEST_TURN_US) & (steps <= SLOWEST_TURN_US)])
        usual = np.full(len(steps), turns[int(_SHORT_SHARE * (len(turns) - 1))] if len(turns) else USUAL_TURN_US)
    return np.where((usual >= FASTEST_TURN_US) & (usual <= SLOWEST_TURN_US), usual, USUAL_TURN_US)


def _explain_steps(steps: NDArray[np.float64]) -> NDArray[np.float64]:
    """Finds the usual duration (M,) of a turn [us] at each of many steps (M,) [us] from one polar scan to the next.

    The steps are explained by the sequence of turn rates that needs the assumptions with the lowest sum of costs: that a
    polar scan is missing, late or early, or that the radar changes its rate.
    """
    rates = _collect_rates(steps)
    turns = steps[:, None] / rates
    whole = np.maximum(1.0, np.round(turns))
    odd = np.abs(turns - whole) > _WHOLE_TURN
    cases = [turns < 1.0 - _WHOLE_TURN, odd, whole > 1.0]
    costs = np.select(cases, [_COST_EARLY, _COST_LATE, _COST_MISSING], 0.0)
    path = _find_cheapest_path(costs, _COST_RATE_CHANGE)
    rows = np.arange(len(steps))
    usual = np.where(odd[rows, path], rates[path], steps / whole[rows, path])
    count = TURNS_AROUND
    around = np.lib.stride_tricks.sliding_window_view(
        np.pad(usual, (count // 2, count - 1 - count // 2), mode="symmetric"), count
    )
    return np.asarray(np.median(around, axis=1))


def _collect_rates(steps: NDArray[np.float64]) -> NDArray[np.float64]:
    """Returns at most eight durations (R,) of a turn [us] that are frequent among steps (M,) [us] and differ clearly."""
    cells = np.round(np.log(steps) / np.log(_RATE_CELL)).astype(np.int64)
    names, counts = np.unique(cells, return_counts=True)
    rates: list[float] = []
    for name in names[np.argsort(-counts, kind="stable")].tolist():
        rate = float(np.median(steps[np.abs(cells - name) <= 1]))
        unlike = all(not 1.0 / ALIKE_TURNS < rate / other < ALIKE_TURNS for other in rates)
        if FASTEST_TURN_US <= rate <= SLOWEST_TURN_US and unlike:
            rates.append(rate)
        if len(rates) == _MOST_RATES:
            break
    return np.array(rates or [USUAL_TURN_US], dtype=np.float64)


def _find_cheapest_path(costs: NDArray[np.float64], change: float) -> NDArray[np.int64]:
    """Finds the sequence of states (M,), one per step, whose costs of states and of changes have the lowest sum.

    Args:
        costs: (M, R) cost of each of R states at each step.
        change: cost of a change of state from one step to the next.
    """
    begins = np.flatnonzero(np.append(True, np.any(costs[1:] != costs[:-1], axis=1)))
    total, states = np.zeros(costs.shape[1]), np.arange(costs.shape[1])
    before = []
    for row in np.add.reduceat(costs, begins):
        best = int(np.argmin(total))
        changed = total > total[best] + change
        before.append(np.where(changed, best, states))
        total = np.where(changed, total[best] + change, total) + row
    state, path = int(np.argmin(total)), []
    for origins in reversed(before):
        path.append(state)
        state = int(origins[state])
    return np.repeat(np.array(path[::-1]), np.diff(begins, append=len(costs)))


def _choose_examples(steps: NDArray[np.int64], count: int) -> list[int]:
    """Chooses the indices of one or two polar scans whose measured durations represent some steps.

    If the recording's first or last step is among the steps, the recording's first or last polar scan (or both) is chosen,
    which the caller may have read already; otherwise, a polar scan in the middle of the longest run of successive steps.

    Args:
        steps: increasing indices of the steps, such as all steps at one rate.
        count: number of all steps of the recording.
    """
    ends = [k for k, step in ((0, 0), (count, count - 1)) if step in (steps[0], steps[-1])]
    runs = np.split(steps, np.flatnonzero(np.diff(steps) > 1) + 1)
    longest = max(runs, key=len)
    return ends or [int(longest[len(longest) // 2])]
