"""Stamps of arrival, one per polar scan, freed of their jitter as far as a turning mass allows.

Where a recording has one stamp per polar scan, it is that of a message or a file, which a computer sets when it finds the
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

from mqslam.config.reading_config import ReadingConfig
from mqslam.core.statistics.gross import SIGMAS_PER_DEVIATION
from mqslam.formats.shared.turns import find_usual_turns

_IGNORED = 1e-4  # weight of a stamp that tells nothing; above zero, so that a whole stretch of them can be solved
_ROUNDS = 8  # most rounds of looking for such stamps; it takes two or three


def smooth_arrivals(stamps_us: NDArray[np.int64], settings: ReadingConfig) -> tuple[NDArray[np.int64], list[str]]:
    """Frees the arrival stamps of polar scans of their jitter.

    Args:
        stamps_us: (N,) increasing stamps of arrival [us].
        settings: how recordings are understood.

    Returns:
        Increasing stamps (N,) [us], the same where they show no jitter, and a note for the user where they do.
    """
    smooth = stamps_us
    for _ in range(_ROUNDS):
        before, smooth = smooth, _smooth_once(smooth, settings)
        if np.array_equal(before, smooth):
            break
    changes = (smooth - stamps_us) * 1e-3
    if not changes.any():
        return stamps_us, []
    return smooth, [
        f"the arrival stamps jitter more than a turning radar can: they are smoothed, which moves them by "
        f"{np.sqrt(np.mean(changes**2)):.1f} ms (RMS) and at most by {np.abs(changes).max():.1f} ms"
    ]


def _smooth_once(stamps_us: NDArray[np.int64], settings: ReadingConfig) -> NDArray[np.int64]:
    """Subtracts from stamps (N,) [us] the delays that they show."""
    if len(stamps_us) < 3:
        return stamps_us
    least_us = settings.least_jitter_s * 1e6
    bends = np.diff(stamps_us, 2).astype(np.float64)
    usual = find_usual_turns(stamps_us, settings)
    tied = _find_ties(stamps_us, usual, settings)
    if not np.any(np.abs(bends[tied]) > least_us):
        return stamps_us
    delays = _estimate_delays(bends, tied, settings.most_turn_change * usual[1:], settings)
    if np.sqrt(np.mean(delays[_mark_members(tied)] ** 2)) < least_us:
        return stamps_us
    numbers = np.arange(len(stamps_us))
    return np.asarray(np.maximum.accumulate(stamps_us - np.round(delays).astype(np.int64) - numbers) + numbers)


def _find_ties(stamps_us: NDArray[np.int64], usual: NDArray[np.float64], settings: ReadingConfig) -> NDArray[np.bool_]:
    """Finds the polar scans, as a mask (N - 2,), that the next two follow without a break at the same turn rate.

    A break is a step after which the stamps stay behind their schedule, or ahead of it: a gap, or a clock that jumps. A
    single late polar scan makes none, since the next ones are in time again.

    Args:
        stamps_us: (N,) of the polar scans [us], three at least.
        usual: (N - 1,) how long a turn usually takes at each step between them [us].
        settings: how recordings are understood.
    """
    count = settings.scans_around_break
    steps = np.diff(stamps_us)
    behind = (stamps_us - stamps_us[0]) - np.concatenate([[0.0], np.cumsum(usual)])
    around = np.lib.stride_tricks.sliding_window_view(np.pad(behind, count, mode="edge"), count)
    before, after = around[1 : len(stamps_us)], around[count + 1 : count + len(stamps_us)]
    gap = after.min(axis=1) - behind[:-1] > (settings.longest_step - 1.0) * usual
    # a second difference of stamps holds six times the variance of their jitter
    spread = SIGMAS_PER_DEVIATION * float(np.median(np.abs(np.diff(steps)))) / np.sqrt(6.0)
    excess = steps - usual
    lasting = (np.median(after, axis=1) - np.median(before, axis=1)) * np.sign(excess)
    least_us = max(settings.break_spreads * spread, settings.least_jitter_s * 1e6)
    jump = (np.abs(excess) > least_us) & (lasting > settings.break_lasts * np.abs(excess))
    jump[: count // 2], jump[-count // 2 :] = False, False  # too few scans on one side to tell a break from late scans
    alike = np.abs(np.diff(np.log(usual))) < np.log(settings.alike)
    broken = gap | jump
    return np.asarray(~broken[:-1] & ~broken[1:] & alike)


def _mark_members(tied: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Marks the polar scans (N,) that are tied to others, from the mask (N - 2,) of the first ones of three."""
    padded = np.pad(tied, 2)
    return padded[2:] | padded[1:-1] | padded[:-2]


def _estimate_delays(
    bends: NDArray[np.float64], tied: NDArray[np.bool_], limits: NDArray[np.float64], settings: ReadingConfig
) -> NDArray[np.float64]:
    """Estimates by how much each stamp (N,) comes later than its turn [us].

    Args:
        bends: (N - 2,) second differences of the stamps [us].
        tied: (N - 2,) which of them are of turns that follow one another steadily.
        limits: (N - 2,) by how much a turn can differ from the one before [us]; stamps that claim more are untied.
        settings: how recordings are understood.
    """
    low, high = np.log10(settings.roughest_ratio), np.log10(settings.smoothest_ratio)
    ratios = np.logspace(low, high, 1 + round(high - low)).tolist()
    weights = np.ones(len(bends) + 2)
    for _ in range(_ROUNDS):
        fits = [_fit_delays(bends, tied, weights, ratio) for ratio in ratios]
        least = min(fit.cost for fit in fits)
        best = next(fit for fit in fits if fit.cost < least + settings.equal_likelihood)
        impossible = tied & (np.abs(bends - np.diff(best.delays, 2)) > limits)
        tied = tied & ~impossible
        trusted = _mark_members(tied) & (weights == 1.0)
        if not trusted.any():
            return np.zeros_like(weights)
        if impossible.any():
            weights = np.ones_like(weights)
            continue
        spread = SIGMAS_PER_DEVIATION * float(np.median(np.abs(best.delays[trusted])))
        stray = np.abs(best.delays) > max(settings.stray_spreads * spread, settings.least_jitter_s * 1e6)
        before, weights = weights, np.where(stray, _IGNORED, 1.0)
        if np.array_equal(before, weights):
            break
    return best.delays


@dataclass(frozen=True, slots=True)
class _Fit:
    """How stamps are best split at a ratio of variances.

    Args:
        delays: (N,) of the stamps [us].
        cost: twice the negative logarithm of the restricted likelihood of the ratio, up to a constant.
    """

    delays: NDArray[np.float64]
    cost: float


def _fit_delays(bends: NDArray[np.float64], tied: NDArray[np.bool_], weights: NDArray[np.float64], ratio: float) -> _Fit:
    """Splits stamps into delays and turns: least squares of the delays and, `ratio` times, of the turns' second differences.

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
