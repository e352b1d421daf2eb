"""The scale of the radar's ranges: what other sensors show of it, and how well the lengths of a trajectory are known.

psi shows nothing of the scale: bins that are longer than stated stretch map and motion alike. Two things are known of it
beforehand. The length of a bin is stated to a few digits, or assumed from the format of the recording. psi measures the
range offset, and an error of the offset changes all lengths by a share that each recording shows. GNSS fixes measure
lengths themselves, and so does odometry as far as `odometry.sigma_travel` trusts its scale. If they contradict what is
known beforehand, the ranges are scaled. Otherwise the ranges stay as they are.
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

# Standard deviation of the relative error of a stated length of the bins: three or four digits are usual.
STATED: Final = 0.0005
# The same where the length is assumed: lengths published for Navtech's radars differ by up to 1.4 % (0.0432 and 0.0438 m).
ASSUMED: Final = 0.005
# The same where nothing but other sensors shows the scale; a larger error would be a wrong unit.
UNKNOWN: Final = 0.05
# Standard deviation of the range offset [m] where psi does not measure it: Navtech's radars have -0.3 m.
_OFFSET_M: Final = 0.3
# Relative change of lengths per metre of the offset [1/m] where psi does not measure it: 0.01 to 0.03 in streets.
_LENGTHENING: Final = 0.02
# Other sensors contradict the radar's scale from this many standard deviations.
_CONTRADICTION: Final = 3.0
_ROUNDS: Final = 2  # rounds in which other sensors are joined at the scale that they showed before; it settles in them


@dataclass(frozen=True, slots=True)
class RangeScale:
    """The scale of the radar's ranges, as a run uses it.

    Args:
        factor: what the recording's ranges are multiplied by; 1 where no other sensor contradicts them.
        sigma: standard deviation of the factor.
        prior: standard deviation of the factor without the sensors of the graph, with which the graph computes covariances.
        statements: sentences for the user.
    """

    factor: float
    sigma: float
    prior: float
    statements: tuple[str, ...]

    @classmethod
    def beforehand(cls, is_assumed: bool, errors: RangeErrors | None) -> RangeScale:
        """Returns what is known of the scale before other sensors are asked.

        Args:
            is_assumed: whether the length of a range bin is assumed and not stated by the recording or the settings.
            errors: errors of the ranges as psi shows them; None if psi does not show them.
        """
        bins = ASSUMED if is_assumed else STATED
        offset = _OFFSET_M * _LENGTHENING
        if errors is not None:
            unused = errors.offset if errors.contradicts else 0.0  # psi shows it, but a run does not use it
            offset = abs(errors.lengthening) * float(np.hypot(errors.sigmas[0], unused))
        sigma = float(np.hypot(bins, offset))
        word = "assumed" if is_assumed else "stated"
        return cls(
            1.0,
            sigma,
            sigma,
            (
                f"the radar alone knows lengths to ± {sigma:.2%}: ± {bins:.2%} by the {word} length of the range bins and "
                f"± {offset:.2%} by the range offset",
            ),
        )

    def replace_by(self, shown: ShownScale, factor: float) -> RangeScale:
        """Returns the scale with a factor that other sensors show if it contradicts what is known, else this scale.

        Args:
            shown: what other sensors show of the ranges once they are multiplied by the factor.
            factor: what the ranges are to be multiplied by.
        """
        if abs(factor - 1.0) <= _CONTRADICTION * np.hypot(shown.sigma, self.sigma):
            return self
        said = (
            f"by {shown.sensors}, true lengths are {factor:.4f} (± {shown.sigma:.4f}) times those of the radar, and all "
            "ranges are multiplied by this; sensor.range_resolution_m, multiplied by it, does so in other commands"
        )
        return RangeScale(factor, shown.sigma, shown.trust, (said,))


@dataclass(frozen=True, slots=True)
class ShownScale:
    """What other sensors show of the scale of the radar's ranges.

    Args:
        sensors: names of the sensors.
        error: true length over the radar's length, minus 1.
        sigma: standard deviation of the error.
        trust: standard deviation of the error by odometry alone, whose lengths the graph does not use.
    """

    sensors: str
    error: float
    sigma: float
    trust: float

    @classmethod
    def by(cls, joined: Joined, sigma_travel: float) -> ShownScale | None:
        """Returns what other sensors show; None if none of them measures lengths.

        Args:
            joined: the trajectory that the sensors have joined.
            sigma_travel: standard deviation of odometry's travel, as a share of it.
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
    """A trajectory that the other sensors have joined.

    Args:
        problem: the trajectory.
        used: how each sensor is used.
        odometry: motions of odometry before calibration; empty if there is no odometry.
    """

    problem: Problem
    used: SensorUse
    odometry: Sequence[Measurement]


def join_at_scale(
    join: Callable[[float], Joined], scale: RangeScale, settings: OdometryConfig, runner: Runner
) -> tuple[Joined, RangeScale]:
    """Joins other sensors to the radar's motions, at the scale that they show if it contradicts what is known beforehand.

    Args:
        join: joins the sensors to the motions with all distances multiplied by a factor.
        scale: what is known of the scale beforehand.
        settings: settings of the odometry.
        runner: tolerates that the sensors cannot show the scale.
    """
    joined = join(1.0)
    with runner.tolerate("the scale of the ranges by other sensors"):
        shown = None if scale == NOT_OF_RADAR else ShownScale.by(joined, settings.sigma_travel)
        if shown is not None:
            factor, again = 1.0, joined
            for _ in range(_ROUNDS):  # how much a sensor errs is seen only at the right scale
                factor *= 1.0 + shown.error
                again = join(factor)
                shown = ShownScale.by(again, settings.sigma_travel) or shown
            replaced = scale.replace_by(shown, factor)
            if replaced != scale:
                return again, replaced
    return joined, scale


def _compare_odometry(
    motions: Sequence[Measurement], odometry: Sequence[Measurement], sigma_travel: float
) -> tuple[float, float]:
    """Returns odometry's travel over the radar's, minus 1, and how far odometry's scale is trusted (standard deviation)."""
    pairs = [(seen.pose[:2], said.pose[:2]) for seen, said in zip(motions, odometry, strict=False) if seen.on_map]
    if sigma_travel >= UNKNOWN or not pairs:
        return 0.0, UNKNOWN
    seen, said = np.array(pairs).transpose(1, 0, 2)
    travelled = float(np.sum(seen**2))
    return (float(np.sum(seen * said)) / travelled - 1.0, sigma_travel) if travelled > 0.0 else (0.0, UNKNOWN)
