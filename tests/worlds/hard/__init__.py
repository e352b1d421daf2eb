"""The hard world: a simulated scene as a real radar would see it.

Scatterers that shine, fade and wander with the aspect, things that hide others, traffic, plants, ground, double bounces,
a receiver with its faults and stamps that come in bursts. `make_hard_world` prepares it for a drive, in the
place of the simulator's own world.

A kernel calls only functions of its own file, because numba renews its cache when that file changes, not those of callees.
The numbers of this folder define the hard world: with other numbers the same seed would give other recordings.
"""

from worlds.hard.realism import Realism
from worlds.hard.world import HardWorld, make_hard_world

__all__ = ["HardWorld", "Realism", "make_hard_world"]
