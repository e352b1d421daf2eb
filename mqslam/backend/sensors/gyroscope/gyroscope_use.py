"""Whether a gyroscope agrees with psi, and so may join the pose graph: a bad one must not hurt."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from mqslam.backend.sensors.gyroscope.gyroscope_start import Start, Turns, find_start
from mqslam.backend.sensors.gyroscope.rotation import (
    KNOT_S,
    LONGEST_DELAY_S,
    SIGMA_BIAS,
    SIGMA_SCALE,
    Calibrated,
    Rotation,
    calibrate,
)
from mqslam.backend.sensors.gyroscope.turn_edges import TurnEdges
from mqslam.core.measurement import Measurement, Status
from mqslam.core.sensors import Gyroscope, KnownTurning, Turning
from mqslam.core.wording import describe_delay

# With fewer motions than this that psi found itself, a gyroscope is not calibrated, and not used.
FEWEST_MOTIONS = 40
# A gyroscope that turns more than this many times as far as the radar, or as little, is of another unit or broken, and is
# not used. The scale of smaller errors is put right.
_LARGEST_SCALE = 1.25
# Share of motions in which a calibrated gyroscope may contradict psi by more than three standard deviations. Psi itself is
# wrong in a few.
_MOST_WILD = 0.1
# A delay, a scale or that both turn the same way is told by this many standard deviations.
TOLD_SIGMAS = 5.0
# A smaller error of the clock is put right without a word [s].
DELAY_TOLERANCE_S = 0.01
# A smaller error of the scale is put right and not worth a word.
SCALE_TOLERANCE = 0.01
# A gyroscope whose scale the radar does not tell to within this standard deviation is not used: a turn by a right angle
# would be off by half a degree.
_LARGEST_SCALE_SIGMA = 0.005

_WILD: Final = 3.0  # standard deviations beyond which a turn disagrees with psi's
_LEAST_VARIANCE: Final = 1e-14  # numerical: keeps a turn that psi states to be without error from counting as one


@dataclass(frozen=True, slots=True)
class GyroscopeUse:
    """What became of a gyroscope.

    Args:
        source: where its readings come from.
        statements: what a user should know, in whole sentences; the first one says whether it is used.
        rotation: how its readings become turns of the radar; None where that could not be found.
        edges: its turns; None where it is not used.
    """

    source: str
    statements: tuple[str, ...]
    rotation: Rotation | None = None
    edges: TurnEdges | None = None


def list_turns(motions: Sequence[Measurement], drift: float) -> Turns:
    """Returns the turns of motions, of which those count that were matched.

    Args:
        motions: between successive scans.
        drift: by how much psi's own map turns away in the root of a second [rad].
    """
    rows = [(m.t0, m.t1, m.pose[2], m.covariance[2, 2], m.status is Status.CONVERGED) for m in motions]
    begins, ends, yaws, variances, known = np.array(rows, dtype=np.float64).reshape(-1, 5).T
    return Turns(begins, ends, yaws, variances + _LEAST_VARIANCE, known.astype(np.bool_), drift)


def join_gyroscope(gyroscope: Gyroscope, start_us: int, motions: Sequence[Measurement], drift: float) -> GyroscopeUse:
    """Holds a gyroscope against psi's motions, puts right what can be, and returns its turns if it then agrees.

    Args:
        gyroscope: its readings.
        start_us: stamp [us] of the recording's time zero.
        motions: between successive scans, as the front end measured them.
        drift: by how much the front end's map turns away in the root of a second, as the graph states it [rad].
    """
    turns = list_turns(motions, drift)
    start = find_start(gyroscope, start_us, turns, LONGEST_DELAY_S) if len(motions) else None

    def refuse(why: str, rotation: Rotation | None = None) -> GyroscopeUse:
        return GyroscopeUse(gyroscope.source, (f"the gyroscope ({gyroscope.source}) is not used: {why}",), rotation)

    if len(gyroscope) and not np.ptp(gyroscope.rates, axis=0).any():
        return refuse("its readings never change")
    if start is None:
        return refuse("it covers none of the motions that the radar shows")
    found = calibrate(gyroscope, start, turns)
    both = int(np.isfinite(found.residuals).sum())
    if both < FEWEST_MOTIONS:
        return refuse(f"only {both} motions show both the radar's turn and its own, and {FEWEST_MOTIONS} are needed")
    why = _find_fault(gyroscope, start, turns, found)
    if why is not None:
        return refuse(why, found.rotation)
    statements = (f"the gyroscope ({gyroscope.source}) is used", *_describe_corrections(found.rotation))
    return GyroscopeUse(gyroscope.source, statements, found.rotation, _make_edges(found, turns))


def find_turning(gyroscope: Gyroscope, start_us: int, motions: Sequence[Measurement], drift: float) -> KnownTurning | None:
    """Returns how far the radar turns, as a gyroscope says that agrees with psi's motions; None where it does not.

    The arguments are those of `join_gyroscope`.
    """
    use = join_gyroscope(gyroscope, start_us, motions, drift)
    rotation = use.rotation
    if use.edges is None or rotation is None:
        return None
    turning = Turning.integrate(gyroscope, start_us, "xyz".index(rotation.axis))
    return KnownTurning(turning, rotation.sign * rotation.scale, rotation.delay_s, rotation.bias)


def _find_fault(gyroscope: Gyroscope, start: Start, turns: Turns, found: Calibrated) -> str | None:
    """Returns why a gyroscope cannot be used, or None."""
    rotation = found.rotation
    is_told = rotation.scale > TOLD_SIGMAS * rotation.scale_sigma
    if not is_told or not start.is_convincing():
        return "the radar turned too little, or the gyroscope too differently, to tell that both turn together"
    if not 1.0 / _LARGEST_SCALE <= rotation.scale <= _LARGEST_SCALE:
        is_degrees = abs(np.rad2deg(rotation.scale) - 1.0) < 0.25
        unit = ", as if it were in degrees per second; convert its rates to rad/s" if is_degrees else ""
        return f"the radar turns {rotation.scale:.3g} times as far as it says{unit}"
    if rotation.scale_sigma > _LARGEST_SCALE_SIGMA:
        return (
            f"its scale is known to {rotation.scale_sigma:.1%} only, since the turns that the front end measured are too "
            "few or too unsure"
        )
    if abs(rotation.delay_s) > LONGEST_DELAY_S:
        return f"its clock is {describe_delay(rotation.delay_s)} or more; correct its stamps"
    variances = turns.variances + rotation.noise.white**2 * (turns.ends - turns.begins)
    known = np.isfinite(found.residuals)
    wild = float(np.mean(found.residuals[known] ** 2 > _WILD**2 * variances[known]))
    if wild > _MOST_WILD:
        return f"it contradicts the radar in {wild:.0%} of the motions"
    half = len(turns.yaws) // 2
    first, second = (calibrate(gyroscope, start, turns, part).rotation for part in (slice(half), slice(half, None)))
    sigma_s = float(np.hypot(first.delay_sigma_s, second.delay_sigma_s))
    apart_s = abs(second.delay_s - first.delay_s)
    if apart_s > max(TOLD_SIGMAS * sigma_s, DELAY_TOLERANCE_S):
        early, late = (describe_delay(part.delay_s) for part in (first, second))
        return f"its clock runs at another rate than the radar's: it is {early} in the first half and {late} in the second"
    return None


def _describe_corrections(rotation: Rotation) -> list[str]:
    """Returns what was put right of a gyroscope, as sentences."""
    sentences = []
    if rotation.axis != "z":
        sentences.append(f"the gyroscope's {rotation.axis} axis is taken as the radar's vertical, since its turns fit there")
    if rotation.sign < 0.0:
        sentences.append(
            "the gyroscope turns the other way than the radar: it is taken to be mounted upside down, unless the radar is"
        )
    if abs(rotation.delay_s) > max(TOLD_SIGMAS * rotation.delay_sigma_s, DELAY_TOLERANCE_S):
        sentences.append(f"the gyroscope's clock is {describe_delay(rotation.delay_s)}, which is put right")
    off = rotation.scale - 1.0
    if abs(off) > max(TOLD_SIGMAS * rotation.scale_sigma, SCALE_TOLERANCE):
        far = "too little" if off > 0.0 else "too far"
        sentences.append(f"the gyroscope turns {abs(off) / rotation.scale:.1%} {far}, which is put right")
    return sentences


def _make_edges(found: Calibrated, turns: Turns) -> TurnEdges:
    """Returns the turns of a gyroscope; one that contradicts psi states the contradiction as its noise."""
    rotation, lasts = found.rotation, turns.ends - turns.begins
    white = rotation.noise.white**2 * lasts + _LEAST_VARIANCE
    squares = np.nan_to_num(found.residuals) ** 2
    wild = squares > _WILD**2 * (turns.variances + white)
    knots = np.floor((turns.begins - turns.begins[0]) / KNOT_S).astype(np.int64)
    knots = np.unique(knots, return_inverse=True)[1]  # none for times that no motion begins in
    middles = np.bincount(knots, turns.begins + turns.ends) / (2.0 * np.bincount(knots))
    return TurnEdges(
        turns=found.raw,
        lasts=lasts,
        sigmas=np.sqrt(np.where(wild, np.maximum(squares, white), white)),
        knots=knots,
        walks=rotation.noise.walk * np.sqrt(np.diff(middles)),
        bias=rotation.bias,
        scale_error=rotation.scale - 1.0,
        sigma_bias=SIGMA_BIAS,
        sigma_scale=SIGMA_SCALE,
    )
