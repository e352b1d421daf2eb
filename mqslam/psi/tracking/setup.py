"""What stays the same while a recording is tracked."""

from __future__ import annotations

from dataclasses import dataclass

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
    """

    settings: TrackerConfig
    estimator: EstimatorConfig
    beam: Beam
    revolution_s: float
