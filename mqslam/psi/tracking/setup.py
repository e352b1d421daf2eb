"""What stays the same while a recording is tracked."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import NamedTuple

from mqslam.config import EstimatorConfig, TrackerConfig
from mqslam.psi.minimiser import APART_BLUR, APART_SHARE, CORRELATION, kernel_of
from mqslam.psi.place import Beam
from mqslam.psi.scoring.estimator import Kernel

# Number of scans from which a track finds its first motion: three show an acceleration, too.
START_SCANS = 3
# Slowest speed that the cold start tries [m/s]; negative is backwards. Vehicles hardly reverse faster.
SPEED_MIN = -5.0
# Change of yaw rate per 0.25 s that yaw acceleration does not explain, for the first scans of a track, whose turning is
# hardly known yet [rad/s].
_START_OMEGA = 0.08
# Change of yaw acceleration per 0.25 s, for the first scans of a track [rad/s^2]. It is also the standard deviation of a yaw
# acceleration of which nothing is known.
START_ALPHA = 0.6


class Tuning(NamedTuple):
    """How a track is matched to its map. A figure that is to stay comparable fixes its own values.

    Args:
        keyframe_m: a scan joins the map after this much travel [m]. A map of few keyframes takes scans sooner.
        keyframes: number of scans that the map holds.
        final_width: factor on the final widths s and beta_s where a scan is matched to the map, whose many keyframes scatter
            more than the scans of a window.
        first_step: first step of the annealing at which the match of a predicted scan begins. A prediction is nearer to the
            match than the start of a search is, and the widest scale pulls scans back to where the map is denser.
        prediction_margin: least beta_s at which a match begins, in units of the error that is expected of its prediction.
        doubtful_psi: a match whose psi per return is this many times the usual one or more may be at a wrong minimum. Better
            ones are looked for ahead of it, behind it, and turned to either side.
        correlation: number of returns that tell the same (`mqslam.psi.minimiser.CORRELATION`).
        apart_share: factor on the weight of a neighbour that was seen from a quite different direction.
        apart_blur: factor on the blur of such a neighbour.
    """

    keyframe_m: float = 4.0
    keyframes: int = 60
    final_width: float = 1.2
    first_step: int = 1
    prediction_margin: float = 1.0
    doubtful_psi: float = 1.15
    correlation: float = CORRELATION
    apart_share: float = APART_SHARE
    apart_blur: float = APART_BLUR


USUAL = Tuning()


@dataclass(frozen=True, slots=True)
class Setup:
    """The settings of a track and its sensor.

    Args:
        settings: of the tracker.
        estimator: settings of the score and of its minimiser.
        beam: the sensor's errors.
        revolution_s: usual duration of a turn [s].
        tuning: how scans are matched to the map.
        is_reversed: whether the recording is played backward, so that speeds have the opposite sign.

    Attributes:
        matching: settings of the score where a scan is matched to the running map: the final widths are wider.
        young: settings of the tracker for the first scans of a track, whose turning is less sure to go on.
        kernel: the score besides its widths.
    """

    settings: TrackerConfig
    estimator: EstimatorConfig
    beam: Beam
    revolution_s: float
    tuning: Tuning = USUAL
    is_reversed: bool = False
    matching: EstimatorConfig = field(init=False)
    young: TrackerConfig = field(init=False)
    kernel: Kernel = field(init=False)

    @property
    def speeds(self) -> tuple[float, float]:
        """Slowest and fastest forward speed that a cold start tries [m/s]."""
        slowest, fastest = SPEED_MIN, self.settings.speed_max
        return (-fastest, -slowest) if self.is_reversed else (slowest, fastest)

    def __post_init__(self) -> None:
        tuning = self.tuning
        wider = {name: tuning.final_width * getattr(self.estimator, name) for name in ("s", "beta_s")}
        livelier = {"sigma_omega": _START_OMEGA, "sigma_alpha": START_ALPHA}
        views = {"apart_share": tuning.apart_share, "apart_blur": tuning.apart_blur * self.estimator.blur_m}
        object.__setattr__(self, "matching", self.estimator.model_copy(update=wider))
        object.__setattr__(self, "young", self.settings.model_copy(update=livelier))
        object.__setattr__(self, "kernel", kernel_of(self.estimator, self.revolution_s)._replace(**views))
