"""What the paper drove: its sensor, a slow robot outdoors between buildings, three constant motions."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mqslam.config import Config
from mqslam.core import se2
from mqslam.core.motion import CONSTANT_VELOCITY
from mqslam.core.scans import Returns
from mqslam.detection.stage import detect_stretch
from mqslam.psi.place import PointSet, beam_of, place
from mqslam.psi.window import WindowMotion, drop_start, find_window_motion
from mqslam.simulator import ConstantDrive, SensorModel, simulated_recording, yard_scene

CASES = ((0.0, -0.3840), (0.1, 0.2967), (1.0, -0.1920))
"""v [m/s] and omega [rad/s] of the cases of Table I."""
PAPER_LARGEST = (0.1, 0.0227)
"""Largest errors of v [m/s] and omega [rad/s] in the paper's Table I; nothing else of its results is at hand."""
SENSOR = SensorModel(turn_rate_hz=2.0, azimuths=720, range_resolution=0.25, max_range=400.0)
REVOLUTION_S = 1.0 / SENSOR.turn_rate_hz
SPEEDS = np.arange(-0.5, 1.6, 0.4)  # [m/s] grid of the estimator's start
YAW_RATES = np.linspace(-0.6, 0.6, 25)  # [rad/s]
_CONFIG = Config()
_BEAM = beam_of(_CONFIG.estimator, 0.0)


@dataclass(frozen=True, slots=True)
class PaperWindow:
    """Returns of a constant motion; time zero is the window's start.

    Args:
        motion: (2,) true v [m/s], omega [rad/s].
        returns: of all revolutions.
    """

    motion: NDArray[np.float64]
    returns: Returns

    def points(self, motion: se2.Array) -> PointSet:
        """The window rendered under v [m/s], omega [rad/s]."""
        return drop_start(place(self.returns, 0.0, np.zeros(3), motion, CONSTANT_VELOCITY, _BEAM))

    def estimate(self) -> WindowMotion:
        """Our estimate of v [m/s], omega [rad/s], without any start."""
        return find_window_motion(
            self.returns, 0.0, REVOLUTION_S, _CONFIG.estimator, _BEAM, SPEEDS, YAW_RATES, CONSTANT_VELOCITY
        )


def paper_window(case: tuple[float, float], seed: int, revolutions: int) -> PaperWindow:
    """Simulate a case in the yard of a seed, as the detector with its default settings sees it."""
    drive = ConstantDrive(*case)
    recording = simulated_recording(yard_scene(seed), drive, duration_s=revolutions * REVOLUTION_S, sensor=SENSOR, seed=seed)
    found = detect_stretch(recording, _CONFIG.detector, 0, revolutions)
    return PaperWindow(np.array(case), Returns.concatenate(found.returns))
