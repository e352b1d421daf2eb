"""What stays the same while a recording is tracked."""

from __future__ import annotations

from dataclasses import dataclass, field

from mqslam.config import EstimatorConfig, TrackerConfig
from mqslam.psi.place import Beam


@dataclass(frozen=True, slots=True)
class Setup:
    """The settings of a track and its sensor.

    Args:
        settings: of the tracker.
        estimator: settings of the score and of its minimiser.
        beam: the sensor's errors.
        revolution_s: usual duration of a turn [s].

    Attributes:
        matching: settings of the score where a scan is matched to the running map: the final widths are wider.
        young: settings of the tracker for the first scans of a track, whose turning is less sure to go on.
    """

    settings: TrackerConfig
    estimator: EstimatorConfig
    beam: Beam
    revolution_s: float
    matching: EstimatorConfig = field(init=False)
    young: TrackerConfig = field(init=False)

    def __post_init__(self) -> None:
        wider = {name: self.settings.final_width * getattr(self.estimator, name) for name in ("s", "beta_s")}
        livelier = {"sigma_omega": self.settings.start_omega, "sigma_alpha": self.settings.start_alpha}
        object.__setattr__(self, "matching", self.estimator.model_copy(update=wider))
        object.__setattr__(self, "young", self.settings.model_copy(update=livelier))
