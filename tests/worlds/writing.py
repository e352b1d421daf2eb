"""Simulated drives in the kind and in the hard world, as recordings on disk."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Any

from worlds.hard import make_hard_world

from mqslam.simulator import ClearWorld, MakeWorld, SimulatedRecording, simulate

WORLDS: Mapping[str, MakeWorld] = {"kind": ClearWorld, "hard": make_hard_world}
"""The worlds that a scene can be seen in, by their names: everything shows from everywhere, or as hard as real radar."""


def simulate_hard(out: Path, *, scene: str = "street", **options: Any) -> SimulatedRecording:
    """Simulates a drive in the hard world and writes it, as `mqslam.simulator.simulate` does one in the kind world.

    Args:
        out: folder to make.
        scene: one of `mqslam.simulator.SCENES`, or `queue`: the city, without its traffic, where vehicles keep exact
            pace with the radar for a minute.
        options: the others of `mqslam.simulator.simulate`.
    """
    if scene == "queue":
        return simulate(out, scene="city", movers=0, world=partial(make_hard_world, queue=True), **options)
    return simulate(out, scene=scene, world=make_hard_world, **options)
