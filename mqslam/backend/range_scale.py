"""Estimates the scale of the radar's ranges and its uncertainty, from the stated bin length, psi and other sensors.

psi does not show the scale: if the range bins are longer than stated, the map and all motions grow by the same factor.
Before other sensors are used, the uncertainty of the scale has two sources. The first is the length of a bin, which is
stated to a few digits, or assumed from the format of the recording. The second is the range offset, a constant error of all
ranges. psi measures the offset only approximately; how much the rest changes lengths depends on the recording.
GNSS fixes measure lengths, and so does odometry, with the relative error `odometry.sigma_travel`. If these sensors
contradict the radar's scale, the ranges are multiplied by a factor. Otherwise the ranges stay as they are.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Final, NamedTuple

import numpy as np

from mqslam.backend.marginals import measure_scale_error
from mqslam.backend.problem import Problem
from mqslam.backend.sensor_use import SensorUse
from mqslam.config import OdometryConfig
from mqslam.core.measurement import Measurement
from mqslam.execution.runner import Runner
from mqslam.psi.ranging import RangeErrors

# Standard deviation of the relative error of a stated bin length, which usually has three or four digits.
STATED: Final = 0.0005
# Standard deviation of the relative error of an assumed bin length: the lengths published for Navtech's radars differ by up
# to 1.4 % (0.0432 and 0.0438 m).
ASSUMED: Final = 0.005
# Prior standard deviation of the scale's relative error without odometry; a larger error would be a wrong unit.
UNKNOWN: Final = 0.05
# Standard deviation of the range offset [m] where psi does not measure it: Navtech's radars have -0.3 m.
_OFFSET_M: Final = 0.3
# Relative change of lengths per metre of the offset [1/m] where psi does not measure it: 0.01 to 0.03 in streets.
_LENGTHENING: Final = 0.02
# Other sensors contradict the radar's scale if they differ by more than this many standard deviations.
_CONTRADICTION: Final = 3.0
_ROUNDS: Final = 2  # rounds in which the scale is measured again at the scale that was measured so far; two suffice


@dataclass(frozen=True, slots=True)
class RangeScale:
    """The scale of the radar's ranges, as a run uses it.

    Args:
        factor: factor by which the recording's ranges are multiplied; 1 if no other sensor contradicts them.
        sigma: standard deviation of the factor.
        prior: standard deviation of the factor without the sensors in the graph; it is the graph's prior of the scale error.
        statements: sentences for the user.
    """

    factor: float
    sigma: float
    prior: float
    statements: tuple[str, ...]

    @classmethod
    def beforehand(cls, is_assumed: bool, errors: RangeErrors | None) -> RangeScale:
        """Returns a scale of 1 with the uncertainty that it has before other sensors are used.

        Args:
            is_assumed: whether the length of a range bin is assumed, and not stated by the recording or the settings.
            errors: errors of the ranges as psi shows them; None if psi does not show them.
        """
        bins = ASSUMED if is_assumed else STATED
        offset = _OFFSET_M * _LENGTHENING
        if errors is not None:
            unused = errors.offset if errors.contradicts else 0.0  # psi shows an offset that the run does not correct
            offset = abs(errors.lengthening) * float(np.hypot(errors.sigmas[0], unused))
        sigma = float(np.hypot(bins, offset))
        word = "assumed" if is_assumed else "stated"
        return cls(
            1.0,
            sigma,
            sigma,
            (
                f"the radar alone measures lengths to ± {sigma:.2%}: ± {bins:.2%} from the {word} length of the range "
                f"bins and ± {offset:.2%} from the range offset",
            ),
        )

    def replace_by(self, shown: ShownScale, factor: float) -> RangeScale:
        """Returns the scale that other sensors show if it contradicts this scale; else this scale, with one more statement.

        Args:
            shown: the scale error that other sensors still show after the ranges have been multiplied by the factor.
            factor: the factor by which the ranges must be multiplied to agree with the other sensors.
        """
        said = f"according to {shown.sensors}, true lengths are {factor:.4f} (± {shown.sigma:.4f}) times the radar's lengths"
        if abs(factor - 1.0) <= _CONTRADICTION * np.hypot(shown.sigma, self.sigma):
            said = f"{said}, which does not contradict the radar: the ranges stay as they are"
            return replace(self, statements=(*self.statements, said))
        said = (
            f"{said}, and this run multiplies all ranges by this factor; to do so in other commands, multiply "
            "sensor.range_resolution_m by it"
        )
        return RangeScale(factor, shown.sigma, shown.trust, (said,))


@dataclass(frozen=True, slots=True)
class ShownScale:
    """The relative error of the radar's lengths, as other sensors show it.

    Args:
        sensors: names of the sensors.
        error: true length divided by the radar's length, minus 1.
        sigma: standard deviation of the error.
        trust: standard deviation of the error by odometry alone, or UNKNOWN without odometry. The graph takes it as a prior,
            because the odometry in the graph was scaled to fit the radar and shows no error.
    """

    sensors: str
    error: float
    sigma: float
    trust: float

    @classmethod
    def by(cls, joined: Joined, sigma_travel: float) -> ShownScale | None:
        """Measures the error by the other sensors in a trajectory's graph; returns None if none of them measures lengths.

        Args:
            joined: the trajectory, with the other sensors in its graph.
            sigma_travel: standard deviation of odometry's travel, as a share of the travel.
        """
        problem = joined.problem
        stated, trust = _compare_odometry(problem.measurements, joined.odometry, sigma_travel)
        names = ["GNSS"] * ("gnss" in problem.sensors) + ["odometry"] * (trust < UNKNOWN)
        if not names:
            return None
        graph, optimum = replace(problem, scale_sigma=trust).optimise([])
        error, sigma = measure_scale_error(graph, optimum.values)
        error += stated * (sigma / trust) ** 2  # odometry's scale is the mean of the prior
        return cls(" and ".join(names), error, sigma, trust)


NOT_OF_RADAR: Final = RangeScale(1.0, 0.0, 0.0, ())
"""The scale of a trajectory whose lengths the radar does not measure."""


class Joined(NamedTuple):
    """A trajectory with the other sensors in its graph.

    Args:
        problem: the trajectory.
        used: results of the comparisons of the sensors with the radar.
        odometry: motions of odometry before calibration; empty if there is no odometry.
    """

    problem: Problem
    used: SensorUse
    odometry: Sequence[Measurement]


def join_at_scale(
    join: Callable[[float], Joined], scale: RangeScale, settings: OdometryConfig, runner: Runner
) -> tuple[Joined, RangeScale]:
    """Adds other sensors to the radar's graph, and scales the radar's distances if these sensors contradict its scale.

    Args:
        join: adds the sensors to the radar's motions, after multiplying the distances of these motions by a given factor.
        scale: the scale before other sensors are used.
        settings: settings of the odometry.
        runner: turns a failure of the comparison into a warning; the scale then stays as it is.

    Returns:
        The trajectory with the other sensors in its graph, and the scale of the ranges.
    """
    joined = join(1.0)
    with runner.tolerate("the estimate of the range scale by other sensors"):
        shown = None if scale == NOT_OF_RADAR else ShownScale.by(joined, settings.sigma_travel)
        if shown is not None:
            factor, again = 1.0, joined
            for _ in range(_ROUNDS):  # only at the right scale do the residuals show the noise of a sensor
                factor *= 1.0 + shown.error
                again = join(factor)
                shown = ShownScale.by(again, settings.sigma_travel) or shown
            replaced = scale.replace_by(shown, factor)
            return (joined if replaced.factor == 1.0 else again), replaced
    return joined, scale


def _compare_odometry(
    motions: Sequence[Measurement], odometry: Sequence[Measurement], sigma_travel: float
) -> tuple[float, float]:
    """Returns odometry's travel divided by the radar's travel, minus 1, and the standard deviation of this relative error.

    The standard deviation is `sigma_travel`, the relative error of odometry's travel. If it is too large, or if there is no
    odometry or no travel, 0 and UNKNOWN are returned. Only motions on the front end's map are compared.
    """
    pairs = [(seen.pose[:2], said.pose[:2]) for seen, said in zip(motions, odometry, strict=False) if seen.on_map]
    if sigma_travel >= UNKNOWN or not pairs:
        return 0.0, UNKNOWN
    seen, said = np.array(pairs).transpose(1, 0, 2)
    travelled = float(np.sum(seen**2))
    return (float(np.sum(seen * said)) / travelled - 1.0, sigma_travel) if travelled > 0.0 else (0.0, UNKNOWN)
