"""How long the turns of a radar take: from the stamps of revolutions, and from those of azimuths where there are any."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from mqslam.core.evenly import evenly
from mqslam.core.recording import FASTEST_TURN_US, SLOWEST_TURN_US
from mqslam.formats.shared.sensing import Stamp

USUAL_TURN_US = 250_000
"""A turn of which nothing is known is one of a radar that turns four times a second."""
AROUND = 9
"""The usual turn is the median of so many; fewer steps are looked at one by one."""
ALIKE = 1.25
"""Turns whose durations differ by a smaller factor are turns at the same rate."""
LONGEST = 1.5
"""A step of more usual turns than this holds a gap: at least half a turn is missing."""
_CELL = 1.1  # durations within this factor of one another are counted together
_MOST_RATES = 8  # that a recording is thought to have
_WHOLE = 0.2  # a step is of whole turns if it is that close to it, in turns
_MISSING, _LATE, _SOON, _CHANGE = 1.0, 1.5, 2.0, 4.0  # costs of assumptions: revolutions are missing, come late, come too
# soon, and the radar is told to turn at another rate; each is a rarer thing than the one before
_COMPARED = 128  # azimuths of a turn, at most, that are compared with one another
_FEWEST = 8  # azimuths that show how fast they were swept
Measure = Callable[[int], float | None]


def measure_turn(stamps_us: NDArray[np.float64], angles: NDArray[np.float64]) -> float | None:
    """Measure how long a whole turn takes [us], at the rate at which azimuths were swept.

    The rate is the median over pairs of azimuths at least a quarter of the image apart. Neither bursts of stamps, nor
    azimuths that are missing, nor a few stamps that are late change it much.

    Args:
        stamps_us: (A,) [us], not decreasing, counted from anywhere.
        angles: (A,) [rad], unwrapped.

    Returns:
        The duration, or None where too few azimuths, or stamps and angles that do not sweep as a radar does, tell none.
    """
    if len(angles) < _FEWEST:
        return None
    rows = evenly(len(angles), _COMPARED)
    stamps, turns = stamps_us[rows], angles[rows] / (2.0 * np.pi)
    first, second = np.triu_indices(len(rows), len(rows) // 4)
    swept = np.abs(turns[second] - turns[first])
    moved = swept > 0.0
    if not moved.any():
        return None
    turn = float(np.median((stamps[second] - stamps[first])[moved] / swept[moved]))
    return turn if FASTEST_TURN_US <= turn <= SLOWEST_TURN_US else None


def find_usual_turns(stamps_us: NDArray[np.int64], measure: Measure | None = None) -> NDArray[np.float64]:
    """Find how long a turn usually takes (N - 1,) [us] at each step from one revolution to the next: the measure for gaps.

    It is found from the steps around, since a radar may be told to turn at another rate. Where there are few steps, or
    revolutions are missing regularly, steps do not tell turns from gaps; there the azimuths' own stamps do.

    Args:
        stamps_us: (N,) increasing stamps of the revolutions [us].
        measure: of a revolution's number, how long its turn took by its azimuths' own stamps [us], None where they do not
            say. It may read the revolution: it is asked for all of a few, and for one or two at every turn rate of many.
    """
    usual = _find_usual_steps(np.diff(stamps_us).astype(np.float64))
    if measure is None or not len(usual):
        return usual
    if len(usual) < AROUND:
        return np.array([measure(k) or step for k, step in enumerate(usual.tolist())])
    rates = np.round(np.log(usual / np.median(usual)) / np.log(ALIKE))
    for rate in np.unique(rates):
        steps = np.flatnonzero(rates == rate)
        measured = [turn for k in _choose_examples(steps, len(usual)) if (turn := measure(k)) is not None]
        if measured and np.median(usual[steps]) > ALIKE * np.median(measured):
            usual[steps] = np.median(measured)
    return usual


def place_turns(
    stamps_us: NDArray[np.int64], stamp: Stamp, usual_us: NDArray[np.float64]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Find starts (N,) and durations (N,) [us] of turns of which only their increasing stamps (N,) [us] are known.

    A turn goes on to the next one's stamp, or where stamps are ends, has gone on since the one before's; beside a gap and
    at the open end it takes as long as its neighbour, since the turn rate wanders slowly.

    Args:
        stamps_us: of the turns.
        stamp: what they stamp of the turns.
        usual_us: (N - 1,) how long a turn usually takes at each step between them [us].
    """
    between = np.diff(stamps_us)
    if not len(between):
        durations = np.full(len(stamps_us), USUAL_TURN_US)
    else:
        whole = np.flatnonzero(between <= LONGEST * usual_us)
        own = np.arange(len(stamps_us)) - (stamp == "end")
        usual = usual_us[np.clip(own, 0, len(between) - 1)]
        durations = usual
        if len(whole):
            durations = between[whole[np.minimum(np.searchsorted(whole, own), len(whole) - 1)]]
            alone = ~np.isin(own, whole) & (np.abs(np.log(durations / usual)) > np.log(ALIKE))
            durations = np.where(alone, usual, durations)
        durations = np.round(durations).astype(np.int64)
    return (stamps_us if stamp == "start" else stamps_us - durations), durations


def _find_usual_steps(steps: NDArray[np.float64]) -> NDArray[np.float64]:
    """Find the usual duration (M,) of a turn [us] at each of some steps (M,) [us].

    Of few steps it is one of the shortest: no radar delivers a revolution sooner than it turns, while any may be missing.
    """
    if len(steps) >= AROUND:
        usual = _explain_steps(steps)
    else:
        turns = np.sort(steps[(steps >= FASTEST_TURN_US) & (steps <= SLOWEST_TURN_US)])
        usual = np.full(len(steps), turns[(len(turns) - 1) // 4] if len(turns) else USUAL_TURN_US)
    return np.where((usual >= FASTEST_TURN_US) & (usual <= SLOWEST_TURN_US), usual, USUAL_TURN_US)


def _explain_steps(steps: NDArray[np.float64]) -> NDArray[np.float64]:
    """Find the usual duration (M,) of a turn [us] at each of many steps (M,) [us].

    The steps are explained by the sequence of turn rates that takes the fewest assumptions: that revolutions are missing,
    that one is late, or that the radar is told to turn at another rate.
    """
    rates = _collect_rates(steps)
    turns = steps[:, None] / rates
    whole = np.maximum(1.0, np.round(turns))
    odd = np.abs(turns - whole) > _WHOLE
    path = _find_cheapest_path(np.select([turns < 1.0 - _WHOLE, odd, whole > 1.0], [_SOON, _LATE, _MISSING], 0.0))
    rows = np.arange(len(steps))
    usual = np.where(odd[rows, path], rates[path], steps / whole[rows, path])
    around = np.lib.stride_tricks.sliding_window_view(np.pad(usual, AROUND // 2, mode="symmetric"), AROUND)
    return np.asarray(np.median(around, axis=1))


def _collect_rates(steps: NDArray[np.float64]) -> NDArray[np.float64]:
    """Collect the durations of a turn (R,) [us] that may explain steps: those that occur most, unlike one another."""
    cells = np.round(np.log(steps) / np.log(_CELL)).astype(np.int64)
    names, counts = np.unique(cells, return_counts=True)
    rates: list[float] = []
    for name in names[np.argsort(-counts, kind="stable")].tolist():
        rate = float(np.median(steps[np.abs(cells - name) <= 1]))
        if FASTEST_TURN_US <= rate <= SLOWEST_TURN_US and all(not _are_alike(rate, other) for other in rates):
            rates.append(rate)
        if len(rates) == _MOST_RATES:
            break
    return np.array(rates or [USUAL_TURN_US], dtype=np.float64)


def _find_cheapest_path(costs: NDArray[np.float64]) -> NDArray[np.int64]:
    """Find the states (M,) whose costs, of all costs (M, R) of R states, and the changes between them cost least."""
    begins = np.flatnonzero(np.append(True, np.any(costs[1:] != costs[:-1], axis=1)))
    total, states = np.zeros(costs.shape[1]), np.arange(costs.shape[1])
    before = []
    for row in np.add.reduceat(costs, begins):
        best = int(np.argmin(total))
        changed = total > total[best] + _CHANGE
        before.append(np.where(changed, best, states))
        total = np.where(changed, total[best] + _CHANGE, total) + row
    state, path = int(np.argmin(total)), []
    for origins in reversed(before):
        path.append(state)
        state = int(origins[state])
    return np.repeat(np.array(path[::-1]), np.diff(begins, append=len(costs)))


def _are_alike(one: float, other: float) -> bool:
    """Tell whether two durations are those of turns at the same rate."""
    return 1.0 / ALIKE < one / other < ALIKE


def _choose_examples(steps: NDArray[np.int64], count: int) -> list[int]:
    """Choose revolutions that stand for some of the steps 0..count - 1: the first or last of all, else one amid most."""
    ends = [k for k, step in ((0, 0), (count, count - 1)) if step in (steps[0], steps[-1])]
    runs = np.split(steps, np.flatnonzero(np.diff(steps) > 1) + 1)
    longest = max(runs, key=len)
    return ends or [int(longest[len(longest) // 2])]
