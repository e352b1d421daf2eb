"""Estimates, from stamps of arrival with varying delays, when the revolutions (turns) of a radar ended or began.

Where a recording has one stamp per polar scan, a computer set this stamp when it received the polar scan. A busy computer
sets it late: each stamp has a different delay, and some stamps are later than the stamps of the next polar scans. So polar
scans are ordered by their numbers or messages, never by their stamps. The radar turns steadily, since its antenna has
inertia: the duration of a turn changes little from one turn to the next. The stamp of arrival a_k of turn k is modelled as

    a_k = s_k + jitter,        s_k - 2 s_k+1 + s_k+2 = change of the duration of a turn

where s_k is the true end or start of the turn, the jitter is white with variance r, and the changes are white with variance
q. Both variances are estimated from the stamps themselves (restricted maximum likelihood), and the most probable s_k replace
the a_k. This is the smoother of Whittaker and Henderson (for this model equal to that of Rauch, Tung and Striebel), whose
covariance gives the uncertainty of the s_k.

Stamps that are out of order or far too late are ignored. A turn whose number is missing has no stamp, but keeps its place:
the places of turns count from 0 and include missing turns. Three successive turns are tied if no gap and no change of the
radar's rate lies between them; only tied turns constrain one another.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mqslam.core.statistics import SIGMAS_PER_DEVIATION, pick_evenly
from mqslam.core.wording import count_of
from mqslam.formats.recordings.turns import ALIKE_TURNS, LONGEST_STEP, TURNS_AROUND, USUAL_TURN_US, find_usual_turns
from mqslam.formats.stamps import mark_increasing

_LEAST_JITTER_S = 1e-4  # smaller jitter [s] is not corrected: at 30 m/s a vehicle drives 3 mm in this time
# Smallest and largest of the ratios that are tried: variance of the jitter over variance of the changes of a turn's
# duration. They grow by factors of ten. The largest averages stamps over about a hundred turns.
_ROUGHEST_RATIO, _SMOOTHEST_RATIO = 1e-4, 1e8
# Ratios whose costs (twice the negative log-likelihood) differ by less than this count as equally likely, and the smallest
# one is chosen. Three polar scans cannot tell jitter from changes of the turn rate.
_EQUAL_LIKELIHOOD = 0.01
_MOST_TURN_CHANGE = 0.1  # share by which a turn can be faster or slower than the one before: a rotating mass allows no more
_STRAY_SPREADS = 5.0  # a stamp further than this many spreads of the jitter from its estimate is ignored
_MOST_LATE_S = 3.0  # a stamp later than its estimate by more than this [s] is damaged, not late
_MOST_EARLY = 0.5  # a stamp earlier than its estimate by more turns than this is damaged, since nothing arrives early
_SCANS_AROUND_BREAK = 8  # number of polar scans on each side of a step that show whether it is a lasting break
_BREAK_SPREADS = 7.0  # a step further than this many spreads of the jitter from the usual one may be a break
_BREAK_LASTS = 0.6  # share of an unusual step by which the stamps after it must stay shifted for it to be a break
_NEAR = 3  # breaks that are at most this many polar scans apart may be one break
_IGNORED = 1e-4  # weight of an ignored stamp; above zero, so that a whole stretch of them can be solved
_ROUNDS = 8  # limit on the rounds that look for stamps to ignore; two or three suffice
_PROBES = 64  # the median variance of all polar scans is estimated from at most this many
_LOW = 0.2  # quantile of the delays of some stamps that is compared; it is low, since late stamps have the largest delays
_AVERAGED = 37  # number of turns whose usual durations are averaged: a median of nine turns still shows the jitter of stamps
_MOST_MISSING = 100  # a larger step between numbers counts as this many turns, which keeps the arrays small


@dataclass(frozen=True, slots=True)
class Arrivals:
    """Stamps of the ends or starts of a radar's revolutions, estimated from stamps of arrival.

    Args:
        stamps_us: (N,) int64 [us], strictly increasing; equal to the stamps of arrival if these show no delays.
        sigma_s: standard deviation of one stamp [s]; 0 if the stamps of arrival show no delays.
        notes: a message for the user on the size of the delays; empty if the stamps show no delays.
        faults: a message for the user on damaged stamps of arrival; empty if no stamp is damaged.
    """

    stamps_us: NDArray[np.int64]
    sigma_s: float = 0.0
    notes: tuple[str, ...] = ()
    faults: tuple[str, ...] = ()


def estimate_arrivals(stamps_us: NDArray[np.int64], numbers: NDArray[np.int64] | None = None) -> Arrivals:
    """Estimates the stamps of polar scans by removing the delays from their stamps of arrival; a single stamp is kept.

    Args:
        stamps_us: (N,) stamps of arrival [us] in the order of the polar scans; they may repeat and run backward.
        numbers: (N,) increasing numbers that the recorder gave to polar scans; some may be missing. None: none is missing.
    """
    if len(stamps_us) < 2:
        return Arrivals(stamps_us)
    numbers = np.arange(1, len(stamps_us) + 1) if numbers is None else numbers
    places = np.concatenate([[0], np.cumsum(np.minimum(np.diff(numbers), _MOST_MISSING))])
    smooth, sigma_s = stamps_us, 0.0
    for _ in range(1 + _ROUNDS):  # absurd stamps first give absurd results, such as turns faster than any radar's
        before = smooth
        smooth, usual, sigma = _estimate_once(smooth, places)
        sigma_s = max(sigma_s, sigma)
        if np.array_equal(before, smooth):
            break
    delays = stamps_us - smooth
    damaged = (delays > _MOST_LATE_S * 1e6) | (delays < -_MOST_EARLY * usual)
    faults = (_describe_damaged(numbers, damaged),) if damaged.any() else ()
    changes = delays[~damaged] * 1e-3
    if not changes.any():
        return Arrivals(smooth, sigma_s, (), faults)
    note = (
        f"the arrival stamps jitter more than a turning radar can: they are smoothed, which moves them by "
        f"{np.sqrt(np.mean(changes**2)):.1f} ms (RMS) and at most by {np.abs(changes).max():.1f} ms, and leaves them "
        f"uncertain by {sigma_s * 1e3:.1f} ms"
    )
    return Arrivals(smooth, sigma_s, (note,), faults)


def _estimate_once(stamps_us: NDArray[np.int64], places: NDArray[np.int64]) -> tuple[NDArray[np.int64], float, float]:
    """Removes the delays from the stamps of arrival (N,) [us] of N turns.

    `places` (N,) are the numbers of these turns, counted from 0 over all turns, the missing ones included.

    Returns:
        The estimated stamps (N,) [us], the usual duration of a turn [us], and the standard deviation of one stamp [s].
    """
    known = _mark_in_time(stamps_us, places)
    smooth, usual = _fill_turns(stamps_us, places, known)
    weights, sigma_s = np.full(len(smooth), _IGNORED), 0.0
    weights[places[known]] = 1.0
    for _ in range(_ROUNDS):
        before = smooth
        smooth, sigma = _smooth_once(smooth, weights)
        sigma_s = max(sigma_s, sigma)
        if np.array_equal(before, smooth):
            break
    return smooth[places], usual, sigma_s


def _describe_damaged(numbers: NDArray[np.int64], damaged: NDArray[np.bool_]) -> str:
    """Returns a message on the damaged stamps that a mask (N,) marks, with the number of the first such polar scan."""
    count = int(np.count_nonzero(damaged))
    others = f" and of {count_of(count - 1, 'other')}" if count > 1 else ""
    return (
        f"the stamp of polar scan number {numbers[damaged][0]}{others} among {len(numbers)} lies too far from the stamps "
        "around it: the time of the turn is estimated from the other stamps"
    )


def _find_durations(stamps_us: NDArray[np.int64], places: NDArray[np.int64]) -> NDArray[np.float64]:
    """Finds the usual duration (N - 1,) of a turn [us] between stamps (N,) [us] of turns with the numbers `places` (N,)."""
    steps = np.maximum(1, np.diff(stamps_us) // np.diff(places))
    return find_usual_turns(np.append(0, np.cumsum(steps)))


def _mark_in_time(stamps_us: NDArray[np.int64], places: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Returns a mask (N,) of the stamps [us] that increase and are not too late; `places` (N,) number their turns.

    A stamp is too late if the stamp of a later turn follows it sooner than the fastest plausible rate of the radar allows.
    """
    from scipy.ndimage import minimum_filter1d

    rows = np.flatnonzero(mark_increasing(stamps_us.tolist()))
    if len(rows) < 2:
        return np.isin(np.arange(len(stamps_us)), rows)
    durations = minimum_filter1d(_find_durations(stamps_us[rows], places[rows]), TURNS_AROUND)
    early = stamps_us[rows] - np.append(0.0, np.cumsum(durations / ALIKE_TURNS * np.diff(places[rows])))
    in_time = early <= np.minimum.accumulate(early[::-1])[::-1]
    return np.isin(np.arange(len(stamps_us)), rows[in_time])


def _fill_turns(
    stamps_us: NDArray[np.int64], places: NDArray[np.int64], known: NDArray[np.bool_]
) -> tuple[NDArray[np.int64], float]:
    """Returns the stamp of every turn (M,) [us], missing turns included, and the usual duration of a turn [us].

    The N stamps of arrival [us] belong to the turns numbered `places` (N,). The stamps that the mask `known` (N,) marks are
    kept. All other turns are spread evenly between the known turns; before the first and after the last known turn, they
    follow at the usual duration. Where a gap lies between two known turns, another turn is put after the gap if its stamp of
    arrival lies there, else before the gap.
    """
    stamps, counts = stamps_us[known], places[known]
    apart, steps, durations = np.diff(counts), np.diff(stamps), _find_durations(stamps, counts)
    usual = float(np.median(durations)) if len(durations) else float(USUAL_TURN_US)
    every = np.arange(places[-1] + 1)
    filled = np.interp(every, counts, stamps.astype(np.float64))
    filled += usual * (np.minimum(every - counts[0], 0) + np.maximum(every - counts[-1], 0))
    arrived = np.zeros(len(every))
    arrived[places] = stamps_us
    for k in np.flatnonzero((apart > 1) & (steps > (apart + LONGEST_STEP - 1.0) * durations)).tolist():
        between = every[counts[k] + 1 : counts[k + 1]]
        first = stamps[k] + durations[k] * (between - counts[k])
        second = stamps[k + 1] - durations[k] * (counts[k + 1] - between)
        filled[between] = np.where(np.maximum.accumulate(arrived[between] > second - 0.5 * durations[k]), second, first)
    return np.round(filled).astype(np.int64), usual


def _smooth_once(stamps_us: NDArray[np.int64], known: NDArray[np.float64]) -> tuple[NDArray[np.int64], float]:
    """Returns the stamps (N,) [us] without delays and the standard deviation of a stamp [s], which is 0 if no delay is seen.

    Args:
        stamps_us: (N,) increasing stamps of turns [us].
        known: (N,) weights of the stamps; near zero where a stamp is only estimated.
    """
    if len(stamps_us) < 3:
        return stamps_us, 0.0
    least_us = _LEAST_JITTER_S * 1e6
    bends = np.diff(stamps_us, 2).astype(np.float64)
    usual = find_usual_turns(stamps_us)
    tied = _find_ties(stamps_us, usual)
    if not np.any(np.abs(bends[tied]) > least_us):
        return stamps_us, 0.0
    fit = _estimate_delays(bends, tied, known, usual[1:])
    if fit is None or np.sqrt(np.mean(fit.delays[_mark_members(tied)] ** 2)) < least_us:
        return stamps_us, 0.0
    numbers = np.arange(len(stamps_us))
    smooth = np.maximum.accumulate(stamps_us - np.round(fit.delays).astype(np.int64) - numbers) + numbers
    return np.asarray(smooth), fit.measure_sigma(_mark_members(tied)) * 1e-6


def _find_ties(stamps_us: NDArray[np.int64], usual: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Returns a mask (N - 2,) of the polar scans that are tied to the next two: without a break, and at the same rate.

    A break is a step after which all stamps are later or earlier than expected, because of a gap or a clock that jumps. One
    late polar scan is no break.

    Args:
        stamps_us: (N,) stamps of the polar scans [us], at least three.
        usual: (N - 1,) usual duration of a revolution [us] at each step from one polar scan to the next.
    """
    from scipy.ndimage import maximum_filter1d, uniform_filter1d

    alike = np.abs(np.diff(np.log(usual))) < np.log(ALIKE_TURNS)
    rates = np.split(usual, np.flatnonzero(~alike) + 1)
    usual = np.concatenate([uniform_filter1d(rate, min(_AVERAGED, len(rate)), mode="nearest") for rate in rates])
    count = _SCANS_AROUND_BREAK
    steps = np.diff(stamps_us)
    behind = (stamps_us - stamps_us[0]) - np.concatenate([[0.0], np.cumsum(usual)])
    around = np.lib.stride_tricks.sliding_window_view(np.pad(behind, count, mode="edge"), count)
    before, after = around[1 : len(stamps_us)], around[count + 1 : count + len(stamps_us)]
    gap = after.min(axis=1) - behind[:-1] > (LONGEST_STEP - 1.0) * usual
    # a second difference of stamps holds six times the variance of their jitter
    spread = SIGMAS_PER_DEVIATION * float(np.median(np.abs(np.diff(steps)))) / np.sqrt(6.0)
    excess = steps - usual
    # late stamps come in runs, so low quantiles are compared
    lasting = np.diff(np.quantile([before, after], _LOW, axis=2), axis=0)[0] * np.sign(excess)
    least_us = max(_BREAK_SPREADS * spread, _LEAST_JITTER_S * 1e6)
    jump = (np.abs(excess) > least_us) & (lasting > _BREAK_LASTS * np.abs(excess))
    # near the ends, too few scans lie on one side to distinguish a break from late scans
    jump[: count // 2], jump[-count // 2 :] = False, False
    broken = gap | jump
    # late polar scans next to a break look like further breaks, but these are smaller and do not last whole turns
    sizes = np.where(broken, np.abs(excess), 0.0)
    whole = np.abs(steps - np.round(steps / usual) * usual) < least_us
    broken &= whole | (sizes == maximum_filter1d(sizes, 2 * _NEAR + 1))
    return np.asarray(~broken[:-1] & ~broken[1:] & alike)


def _mark_members(tied: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Returns a mask (N,) of all polar scans that are tied to others; `tied` (N - 2,) marks the first of three tied ones."""
    padded = np.pad(tied, 2)
    return padded[2:] | padded[1:-1] | padded[:-2]


def _estimate_delays(
    bends: NDArray[np.float64],
    tied: NDArray[np.bool_],
    known: NDArray[np.float64],
    usual: NDArray[np.float64],
) -> _Fit | None:
    """Estimates the delays of N stamps; returns None if no stamp with weight 1 belongs to tied turns.

    Successive turns are tied if no gap and no change of the radar's rate lies between them. They are untied if their
    duration would change by more than a rotating mass allows.

    Args:
        bends: (N - 2,) second differences of the stamps [us].
        tied: (N - 2,) True where the three turns of a second difference are tied.
        known: (N,) weights of the stamps; near zero where a stamp is only estimated.
        usual: (N - 2,) usual duration of a turn at each second difference [us].
    """
    for _ in range(_ROUNDS):
        if not np.any(_mark_members(tied) & (known == 1.0)):
            return None
        fit = _choose_fit(bends, tied, known, float(np.median(usual)))
        impossible = tied & (np.abs(bends - np.diff(fit.delays, 2)) > _MOST_TURN_CHANGE * usual)
        if not impossible.any():
            break
        tied = tied & ~impossible
    return fit


def _choose_fit(bends: NDArray[np.float64], tied: NDArray[np.bool_], known: NDArray[np.float64], turn: float) -> _Fit:
    """Splits N stamps into delays and true times, for the likeliest ratio of variances (see `_fit_delays`).

    Stray stamps, which are far from their estimates, get almost no weight. The first ratio that is tried lets the duration
    of turns change least, and each later ratio lets it change more. So several stamps that are late together, because a
    computer was busy, are recognised as late before the estimated turns can follow them. A stray stamp is taken to
    be equally likely at all instants of a turn. `bends` (N - 2,) are the second differences of the stamps [us], `tied`
    (N - 2,) marks the tied differences, `known` (N,) are the weights of the stamps, `turn` is a turn's usual duration [us].
    """
    members = _mark_members(tied) & (known == 1.0)
    cost_stray = 2.0 * np.log(turn) - np.log(2.0 * np.pi) - 1.0
    low, high = np.log10(_ROUGHEST_RATIO), np.log10(_SMOOTHEST_RATIO)
    weights, fits, costs = known, list[_Fit](), list[float]()
    for ratio in np.logspace(high, low, 1 + round(high - low)).tolist():
        for _ in range(_ROUNDS):
            fit, used = _fit_delays(bends, tied, weights, ratio), weights
            early = -fit.delays[members & (fit.delays < 0.0)]  # late stamps do not show the jitter of the others
            spread = SIGMAS_PER_DEVIATION * float(np.median(early)) if len(early) else 0.0
            stray = np.abs(fit.delays) > max(_STRAY_SPREADS * spread, _LEAST_JITTER_S * 1e6)
            weights = np.where(members & stray, _IGNORED, known)
            if np.array_equal(used, weights):
                break
        fits.append(fit)
        costs.append(fit.cost + cost_stray * np.count_nonzero(members & (used < 1.0)))
    return fits[int(np.flatnonzero(np.array(costs) < min(costs) + _EQUAL_LIKELIHOOD)[-1])]


@dataclass(frozen=True, slots=True)
class _Fit:
    """The best split of N stamps into delays and true times, for one ratio of variances (see `_fit_delays`).

    Args:
        delays: (N,) delays of the stamps [us].
        cost: twice the negative logarithm of the restricted likelihood of the ratio, up to a constant.
        factor: (3, N) Cholesky factor of the normal equations, as bands (`scipy.linalg.cholesky_banded`).
        variance: variance of the jitter [us^2].
    """

    delays: NDArray[np.float64]
    cost: float
    factor: NDArray[np.float64]
    variance: float

    def measure_sigma(self, members: NDArray[np.bool_]) -> float:
        """Returns the median standard deviation [us] of at most 64 of the estimated stamps that a mask (N,) marks."""
        from scipy.linalg import cho_solve_banded

        chosen = np.flatnonzero(members)[pick_evenly(int(np.count_nonzero(members)), _PROBES)]
        probes = np.zeros((len(members), len(chosen)))
        probes[chosen, np.arange(len(chosen))] = 1.0
        inverse = cho_solve_banded((self.factor, False), probes)
        return float(np.sqrt(self.variance * np.median(inverse[chosen, np.arange(len(chosen))])))


def _fit_delays(bends: NDArray[np.float64], tied: NDArray[np.bool_], weights: NDArray[np.float64], ratio: float) -> _Fit:
    """Splits N stamps into delays d and true times t; minimises sum(weights d^2) + ratio sum((second differences of t)^2).

    Only tied second differences count. The normal equations (W + ratio D'TD) d = ratio D'T bends have five diagonals: W
    holds the weights (N,), T picks the tied differences, and D takes second differences. `bends` (N - 2,) are the second
    differences of the stamps [us], and `tied` (N - 2,) marks the tied ones. `ratio` is the variance of the jitter divided by
    the variance of the changes of a turn's duration.
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
    free = max(1, count - int(np.count_nonzero(_mark_members(tied) & (weights < 1.0))))
    variance = squares / free + 1.0 / 12.0  # stamps are rounded to whole microseconds
    cost = free * np.log(variance) + 2.0 * float(np.log(factor[-1]).sum()) - count * np.log(ratio)
    return _Fit(delays, float(cost), factor, variance)
