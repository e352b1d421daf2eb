"""What a simulated radar sees, turn by turn: the world that the simulator renders itself, and what another one has to do."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from mqslam.simulator.drive import Drive
from mqslam.simulator.scene import Scene
from mqslam.simulator.sensor import SensorModel, render_polar_scan

START_US = 1_600_000_000_000_000
"""Stamp [us] of a simulated drive's time zero."""


class World(Protocol):
    """A drive through a scene as the radar measures it."""

    def stamps(self, k: int) -> NDArray[np.float64]:
        """Returns the times (A,) [s] at which the azimuths of turn k are said to be measured."""

    def end(self) -> float:
        """Returns the time [s] at which the last turn is said to end."""

    def render(self, k: int) -> NDArray[np.uint8]:
        """Renders the readings (A, B) of turn k; they do not depend on which other turns are rendered."""

    def describe(self) -> dict[str, Any]:
        """Returns what the parameters of a written recording say of the world, for JSON."""


MakeWorld = Callable[[Scene, Drive, SensorModel, int, int], World]
"""Makes a world of a scene, a drive, a radar, the number of its turns, and the seed of all chance."""


@dataclass(frozen=True)
class ClearWorld:
    """A world in which every surface shows from everywhere, and every azimuth is stamped when it is measured.

    Args:
        scene: what reflects.
        drive: how the radar moves.
        sensor: the radar.
        turns: how often it turns.
        seed: of the noise.
    """

    scene: Scene
    drive: Drive
    sensor: SensorModel
    turns: int
    seed: int

    def stamps(self, k: int) -> NDArray[np.float64]:
        """Returns the times (A,) [s] at which the azimuths of turn k are measured."""
        turns = k + np.arange(self.sensor.azimuths) / self.sensor.azimuths
        return np.asarray(turns / self.sensor.turn_rate_hz)

    def end(self) -> float:
        """Returns the time [s] at which the last turn ends."""
        return self.turns / self.sensor.turn_rate_hz

    def render(self, k: int) -> NDArray[np.uint8]:
        """Renders the readings (A, B) of turn k, each azimuth from where the radar is at its stamp in whole microseconds."""
        times = np.asarray((to_stamps(self.stamps(k)) - START_US) * 1e-6, dtype=np.float64)
        poses, twists = self.drive.poses(times), self.drive.twists(times)
        return render_polar_scan(self.scene, poses, twists, times, self.sensor, (self.seed, k))

    def describe(self) -> dict[str, Any]:
        """Returns nothing, since scene, radar and seed say all."""
        return {}


def to_stamps(times: NDArray[np.float64]) -> NDArray[np.int64]:
    """Returns the stamps (N,) [us] of times (N,) [s] of a drive."""
    return START_US + np.round(times * 1e6).astype(np.int64)
