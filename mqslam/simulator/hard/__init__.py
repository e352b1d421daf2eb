"""The hard world: a simulated scene as a real radar would see it.

Scatterers that shine, fade and wander with the aspect, things that hide others, traffic, plants, ground, double bounces,
a receiver with its faults and stamps that come in bursts. `make_hard_world` prepares it for a drive.
"""

from mqslam.simulator.hard.realism import Realism
from mqslam.simulator.hard.world import HardWorld, make_hard_world

__all__ = ["HardWorld", "Realism", "make_hard_world"]
