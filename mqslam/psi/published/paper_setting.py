"""What the paper drove: its sensor, a slow robot outdoors between buildings, three constant motions.

The numbers are the paper's, or define our simulation of its experiment.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mqslam.config import DetectorConfig, EstimatorConfig
from mqslam.core import se2
from mqslam.core.motion import CONSTANT_VELOCITY
from mqslam.core.scans import Returns
from mqslam.detection.stage import detect_stretch
from mqslam.psi.place import PointSet, beam_of, place
from mqslam.psi.window import WindowMotion, drop_start, find_window_motion
from mqslam.simulator import ConstantDrive, SensorModel, make_yard_scene, simulate_recording

CASES = ((0.0, -0.3840), (0.1, 0.2967), (1.0, -0.1920))
"""v [m/s] and omega [rad/s] in the cases of Table I."""
PAPER_LARGEST = (0.1, 0.0227)
"""Largest errors of v [m/s] and omega [rad/s] in the paper's Table I; nothing else of its results is at hand."""
SENSOR = SensorModel(turn_rate_hz=2.0, azimuths=720, range_resolution=0.25, max_range=400.0)
REVOLUTION_S = 1.0 / SENSOR.turn_rate_hz
SPEEDS = np.arange(-0.5, 1.6, 0.4)  # speeds that the estimator's search tries [m/s]
YAW_RATES = np.linspace(-0.6, 0.6, 25)  # yaw rates that the estimator's search tries [rad/s]
_ESTIMATOR = EstimatorConfig()
_BEAM = beam_of(_ESTIMATOR, 0.0)


@dataclass(frozen=True, slots=True)
class PaperWindow:
    """The returns of a window under a constant motion; time zero is the window's start.

    Args:
        motion: (2,) true v [m/s], omega [rad/s].
        returns: of all scans.
    """

    motion: NDArray[np.float64]
    returns: Returns

    def render(self, motion: se2.Array) -> PointSet:
        """Renders the window under v [m/s], omega [rad/s]."""
        return drop_start(place(self.returns, 0.0, np.zeros(3), motion, CONSTANT_VELOCITY, _BEAM))

    def estimate(self) -> WindowMotion:
        """Estimates v [m/s], omega [rad/s] without any start."""
        return find_window_motion(self.returns, 0.0, REVOLUTION_S, _ESTIMATOR, _BEAM, SPEEDS, YAW_RATES, CONSTANT_VELOCITY)


def simulate_window(case: tuple[float, float], seed: int, scans: int) -> PaperWindow:
    """Simulates a number of scans of a case in the yard of a seed, as the detector with its default settings sees them."""
    drive = ConstantDrive(*case)
    recording = simulate_recording(make_yard_scene(seed), drive, duration_s=scans * REVOLUTION_S, sensor=SENSOR, seed=seed)
    detected = detect_stretch(recording, DetectorConfig(), 0, scans)
    return PaperWindow(np.array(case), Returns.concatenate(detected.returns))
