"""The scene of a city: everything that reflects, with vehicles on its lanes.

The numbers of this file define the simulated world: with other numbers the same seed would give other recordings.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from mqslam.simulator.city.blocks import CityThings, build_block
from mqslam.simulator.city.kerbside import furnish_street
from mqslam.simulator.city.polygons import offset_line
from mqslam.simulator.city.streets import CityPlan, lay_plan
from mqslam.simulator.drive import Drive, clear_way, meets
from mqslam.simulator.parts import Array, draw_mover
from mqslam.simulator.scene import Scene

SLOT = 25.0
"""Length of lane [m] that holds one moving vehicle at most, so that vehicles of one lane stay apart."""
USUAL_TRAFFIC = 0.2
"""Share of the slots that hold a vehicle."""


class _Lane(NamedTuple):
    """A straight piece of lane.

    Args:
        start: (2,) [m].
        heading: [rad].
        length: [m].
        speed: of its vehicles [m/s].
    """

    start: Array
    heading: float
    length: float
    speed: float


def make_city_scene(seed: int, *, movers: int | None = None) -> Scene:
    """Makes a city of about 1.3 km by 0.9 km, with 12 km of streets that a drive can use.

    Vehicles move on all lanes and do not give way: `give_way` takes those away that a drive would run into.

    Args:
        seed: another seed is another city.
        movers: number of moving vehicles; None takes one for every 125 m of lane.
    """
    plan = lay_plan(seed)
    things = CityThings()
    for number, block in enumerate(plan.blocks):
        build_block(np.random.default_rng([seed, 5, number]), block, things)
    clearances = plan.clearances()
    for number, street in enumerate(plan.streets):
        clear = (float(clearances[street.ends[0]]), float(clearances[street.ends[1]]))
        furnish_street(np.random.default_rng([seed, 6, number]), street, clear, things)
    traffic = _draw_traffic(np.random.default_rng([seed, 7]), plan, movers)
    return Scene(np.concatenate(things.walls), np.concatenate(things.poles), traffic, np.concatenate(things.plants))


def give_way(scene: Scene, drive: Drive, duration_s: float) -> Scene:
    """Moves vehicles along their lanes so that they do not run into a drive, and takes away those for which that fails.

    Args:
        scene: the scene.
        drive: the sensor's motion.
        duration_s: how long the drive takes [s].
    """
    scene = clear_way(scene, drive, duration_s)
    times = np.arange(0.0, duration_s, 0.05)
    poses = drive.poses(times)
    free = [not meets(mover, mover[4], times, poses) for mover in scene.movers]
    return replace(scene, movers=scene.movers[np.array(free, dtype=np.bool_)])


def _draw_traffic(rng: np.random.Generator, plan: CityPlan, number: int | None) -> Array:
    """Puts vehicles (M, 9) on the lanes of a city, at most one in a slot."""
    lanes = _lay_lanes(rng, plan)
    slots = [(lane, place) for lane in lanes for place in np.arange(0.0, lane.length - SLOT + 1.0, SLOT)]
    number = int(USUAL_TRAFFIC * len(slots)) if number is None else min(number, len(slots))
    movers = np.empty((number, 9))
    for m, slot in enumerate(rng.permutation(len(slots))[:number]):
        lane, place = slots[slot]
        size = draw_mover(rng)
        along = place + rng.uniform(0.0, SLOT - 13.0)
        movers[m] = [*lane.start, lane.heading, lane.length, along, lane.speed, *size, rng.uniform(0.7, 2.5)]
    return movers


def _lay_lanes(rng: np.random.Generator, plan: CityPlan) -> list[_Lane]:
    """Returns the straight pieces of all lanes, between the crossings."""
    clearances = plan.clearances()
    lanes = []
    for street in plan.streets:
        for way in (1, -1):
            line, ends = street.line[::way], street.ends[::way]
            steps = np.diff(line, axis=0)
            lengths = np.hypot(*steps.T)
            for offset in street.profile.lanes:
                moved = offset_line(line, np.full(len(steps), -offset), closed=False)
                speed = street.profile.speed * rng.uniform(0.6, 1.0)
                for piece, step in enumerate(steps):
                    first = clearances[ends[0]] if piece == 0 else 2.0
                    last = clearances[ends[1]] if piece == len(steps) - 1 else 2.0
                    start = moved[piece] + first / lengths[piece] * step
                    length = float(lengths[piece] - first - last)
                    lanes.append(_Lane(start, float(np.arctan2(step[1], step[0])), length, speed))
    return [lane for lane in lanes if lane.length > SLOT]
