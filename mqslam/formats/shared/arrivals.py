"""Stamps of arrival, one per revolution, freed of their jitter as far as a turning mass allows.

Where a recording has one stamp per revolution, it is that of a message or a file, which a computer sets when it finds the
time: each comes late by another delay. The radar itself turns steadily, since its antenna has inertia: the duration of a
turn changes little from one turn to the next. So the stamps a_k of the recording are understood as

    a_k = s_k + jitter,        s_k - 2 s_k+1 + s_k+2 = change of the duration of a turn

with white jitter of variance r and white changes of variance q. Both variances are estimated from the stamps themselves
(restricted maximum likelihood), and the s_k that are most probable given them take the place of the a_k: this is the
smoother of Whittaker and Henderson, equal to that of Rauch, Tung and Striebel for this model. Nothing ties turns to one
another across a gap, or where the radar is told to turn at another rate.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mqslam.formats.shared.turns import ALIKE, LONGEST, find_usual_turns

_LEAST_US = 100.0  # less jitter moves no map: at 30 m/s a vehicle drives 3 mm meanwhile
_RATIOS = np.logspace(-4.0, 8.0, 13)  # of r to q that are tried; the largest averages over about a hundred turns
_EQUAL = 0.01  # costs closer than this are equal: three revolutions cannot tell jitter from changes of the turn rate
_MOST_CHANGE = 0.1  # share of its turn by which no turning mass of some kilograms is slower or faster in the next turn
_STRAY = 5.0  # spreads from its place, beyond which a stamp tells nothing
_IGNORED = 1e-4  # weight of such a stamp; the equations stay solvable where a whole stretch has it
_ROUNDS = 8  # of looking for such stamps, at most
_AROUND = 8  # revolutions on each side that show whether a step is a break
_JUMP, _LASTING = 7.0, 0.6  # spreads of a step that is no jitter, and what must last of it to be a break


def smooth_arrivals(stamps_us: NDArray[np.int64]) -> tuple[NDArray[np.int64], list[str]]:
    """Free the arrival stamps of revolutions of their jitter.

    Args:
        stamps_us: (N,) increasing stamps of arrival [us].

    Returns:
        Increasing stamps (N,) [us], the same where they show no jitter, and a note for the user where they do.
    """
    smooth = stamps_us
    for _ in range(_ROUNDS):
        before, smooth = smooth, _smooth_once(smooth)
        if np.array_equal(before, smooth):
            break
    changes = (smooth - stamps_us) * 1e-3
    if not changes.any():
        return stamps_us, []
    return smooth, [
        f"the arrival stamps jitter more than a turning radar can: they are smoothed, which moves them by "
        f"{np.sqrt(np.mean(changes**2)):.1f} ms (RMS) and at most by {np.abs(changes).max():.1f} ms"
    ]


def _smooth_once(stamps_us: NDArray[np.int64]) -> NDArray[np.int64]:
    """Take the delays that stamps (N,) [us] show from them."""
    if len(stamps_us) < 3:
        return stamps_us
    bends = np.diff(stamps_us, 2).astype(np.float64)
    usual = find_usual_turns(stamps_us)
    tied = _find_ties(stamps_us, usual)
    if not np.any(np.abs(bends[tied]) > _LEAST_US):
        return stamps_us
    delays = _estimate_delays(bends, tied, _MOST_CHANGE * usual[1:])
    if np.sqrt(np.mean(delays[_mark_members(tied)] ** 2)) < _LEAST_US:
        return stamps_us
    numbers = np.arange(len(stamps_us))
    return np.asarray(np.maximum.accumulate(stamps_us - np.round(delays).astype(np.int64) - numbers) + numbers)


def _find_ties(stamps_us: NDArray[np.int64], usual: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Find the revolutions, as a mask (N - 2,), that the next two follow without a break at the same turn rate.

    A break is a step after which the stamps stay behind their schedule, or ahead of it: a gap, or a clock that jumps. A
    revolution that is late makes none, since the next ones are in time again.

    Args:
        stamps_us: (N,) of the revolutions [us], three at least.
        usual: (N - 1,) how long a turn usually takes at each step between them [us].
    """
    steps = np.diff(stamps_us)
    behind = (stamps_us - stamps_us[0]) - np.concatenate([[0.0], np.cumsum(usual)])
    around = np.lib.stride_tricks.sliding_window_view(np.pad(behind, _AROUND, mode="edge"), _AROUND)
    before, after = around[1 : len(stamps_us)], around[_AROUND + 1 : _AROUND + len(stamps_us)]
    gap = after.min(axis=1) - behind[:-1] > (LONGEST - 1.0) * usual
    spread = 1.4826 * float(np.median(np.abs(np.diff(steps)))) / np.sqrt(6.0)  # a bend holds six times jitter's variance
    excess = steps - usual
    lasting = (np.median(after, axis=1) - np.median(before, axis=1)) * np.sign(excess)
    jump = (np.abs(excess) > max(_JUMP * spread, _LEAST_US)) & (lasting > _LASTING * np.abs(excess))
    jump[: _AROUND // 2], jump[-_AROUND // 2 :] = False, False  # too few on one side to tell that from late ones
    alike = np.abs(np.diff(np.log(usual))) < np.log(ALIKE)
    broken = gap | jump
    return np.asarray(~broken[:-1] & ~broken[1:] & alike)


def _mark_members(tied: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Mark the revolutions (N,) that are tied to others, from the mask (N - 2,) of the first ones of three."""
    padded = np.pad(tied, 2)
    return padded[2:] | padded[1:-1] | padded[:-2]


def _estimate_delays(
    bends: NDArray[np.float64], tied: NDArray[np.bool_], limits: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Estimate by how much each stamp (N,) comes later than its turn [us].

    Args:
        bends: (N - 2,) second differences of the stamps [us].
        tied: (N - 2,) which of them are of turns that follow one another steadily.
        limits: (N - 2,) by how much a turn can differ from the one before [us]; stamps that claim more are untied.
    """
    weights = np.ones(len(bends) + 2)
    for _ in range(_ROUNDS):
        fits = [_fit_delays(bends, tied, weights, float(ratio)) for ratio in _RATIOS]
        least = min(fit.cost for fit in fits)
        best = next(fit for fit in fits if fit.cost < least + _EQUAL)
        impossible = tied & (np.abs(bends - np.diff(best.delays, 2)) > limits)
        tied = tied & ~impossible
        trusted = _mark_members(tied) & (weights == 1.0)
        if not trusted.any():
            return np.zeros_like(weights)
        if impossible.any():
            weights = np.ones_like(weights)
            continue
        spread = 1.4826 * float(np.median(np.abs(best.delays[trusted])))
        before, weights = weights, np.where(np.abs(best.delays) > max(_STRAY * spread, _LEAST_US), _IGNORED, 1.0)
        if np.array_equal(before, weights):
            break
    return best.delays


@dataclass(frozen=True, slots=True)
class _Fit:
    """How stamps are best split at a ratio of variances.

    Args:
        delays: (N,) of the stamps [us].
        cost: twice the negative logarithm of the restricted likelihood of the ratio, but for a constant.
    """

    delays: NDArray[np.float64]
    cost: float


def _fit_delays(bends: NDArray[np.float64], tied: NDArray[np.bool_], weights: NDArray[np.float64], ratio: float) -> _Fit:
    """Split stamps into delays and turns: least squares of the delays and, `ratio` times, of the turns' second differences.

    The normal equations (W + ratio D'TD) delays = ratio D'T bends have five diagonals. W are the weights, T picks the
    bends that are tied, D takes second differences.
    """
    from scipy.linalg import cho_solve_banded, cholesky_banded

    ties = np.pad(ratio * tied, 2)
    pulls = ties * np.pad(np.where(tied, bends, 0.0), 2)
    bands = np.zeros((3, len(weights)))
    bands[0, 2:] = ties[2:-2]
    bands[1, 1:] = -2.0 * (ties[2:-1] + ties[1:-2])
    bands[2] = weights + ties[2:] + 4.0 * ties[1:-1] + ties[:-2]
    factor = cholesky_banded(bands)
    delays = cho_solve_banded((factor, False), pulls[2:] - 2.0 * pulls[1:-1] + pulls[:-2])
    squares = float(weights @ delays**2 + ratio * np.sum((bends - np.diff(delays, 2))[tied] ** 2))
    count = int(np.count_nonzero(tied))
    free = max(1, count - int(np.count_nonzero(weights < 1.0)))
    variance = squares / free + 1.0 / 12.0  # stamps are rounded to whole microseconds
    cost = free * np.log(variance) + 2.0 * float(np.log(factor[-1]).sum()) - count * np.log(ratio)
    return _Fit(delays, float(cost))
