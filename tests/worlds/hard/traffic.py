"""Moving vehicles: where they drive, what the box of each hides, and the scatterers along its outline.

Some pace the own vehicle, some come towards it, and some keep to the scene's lanes.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from worlds.hard import chance
from worlds.hard.realism import Realism
from worlds.hard.scatterers import VEHICLE, Scatterers

from mqslam.core import se2
from mqslam.simulator.beam import CORNERS
from mqslam.simulator.drive import Drive
from mqslam.simulator.scene import LANE, Array, Scene

CAR_HEIGHT, TRUCK_HEIGHT = 1.5, 3.2
_YARD = 0.15  # a drive that turns more than this in the mean [rad/m] is on a yard, where no traffic flows
_BEYOND_M = 250.0  # the road goes straight on for so long before and behind the drive [m]
_IN_SIGHT_M = 130.0  # farther vehicles are not rendered
_QUEUE_FROM_S, _QUEUE_FOR_S = 10.0, 60.0  # when the queue keeps exact pace
_QUEUE_LENGTH, _QUEUE_GAP_M = 5, 3.0  # vehicles before and behind in each lane, and the gaps between them [m]
_QUEUE_LEAVES_MPS = 2.0  # how quickly it forms and dissolves
_OWN_M = 2.5  # from the radar to the ends of the own vehicle
_TRUCKS = 1.0 / 6.0  # share of vehicles
_ASIDE_M = 0.2  # vehicles keep so far from what stands [m]
_PACER_S = 30.0  # median time for which a vehicle paces


class Vehicles(NamedTuple):
    """Vehicles at one time."""

    numbers: NDArray[np.int64]  # (V,) their names
    poses: Array  # (V, 3) of their middles [m, m, rad], scene frame
    velocities: Array  # (V, 2) [m/s], scene frame
    sizes: Array  # (V, 3) length, width, height [m]


class _Road(NamedTuple):
    """The path of a drive, continued straight on at both ends."""

    places: Array  # (N,) distance along the road [m], increasing
    poses: Array  # (N, 3) there
    times: Array  # (T,) [s]
    reached: Array  # (T,) distance along the road that the drive has reached at each time [m]
    flow: Array  # (T,) time for which traffic has flowed [s]: it stops with the drive

    def at(self, places: Array, left: Array) -> Array:
        """Returns the poses (N, 3) at places (N,) along the road and so far to the left of it [m]."""
        along = se2.interpolate(self.places, self.poses, places)
        return se2.compose(along, np.column_stack([np.zeros_like(left), left, np.zeros_like(left)]))


class _Pacers(NamedTuple):
    """Vehicles that keep pace with the own one, each for a while."""

    births: Array  # (V,) flow of traffic at which they come [s]
    lives: Array  # (V,) how long they stay [s]
    gaps: Array  # (V,) mean distance ahead of the own vehicle [m]; negative is behind
    closing: Array  # (V,) rate at which the gap grows [m/s]
    sways: Array  # (V,) amplitude of its swaying [m]
    phases: Array  # (V,) of it [rad]
    leads: Array  # (V,) by how much they stop and start sooner than the own vehicle [s]
    left: Array  # (V,) distance to the left of the own lane [m]
    sizes: Array  # (V, 3) length, width, height [m]


@dataclass(frozen=True)
class Traffic:
    """All moving vehicles of a drive."""

    scene: Scene  # whose lanes hold some
    realism: Realism  # how many others there are
    road: _Road | None  # the drive's path; None on a yard
    pacers: _Pacers  # those that keep pace
    oncoming: Array  # (V, 5) place along the road at time zero [m], distance to its left [m], length, width, height [m]
    queue: Array  # (V, 5) distance ahead of the own vehicle [m], distance to its left [m], length, width, height [m]
    # places of what no vehicle drives through; the scene's own vehicles and the queue keep to lanes that are free
    solid: cKDTree

    def vehicles(self, time: float, turn: float) -> Vehicles:
        """Returns the vehicles in sight at a time [s]; their velocities are the means over a turn of so many seconds."""
        in_lanes = self._in_lanes(time)
        groups = [in_lanes]
        if self.road is not None:
            for others in (self._pace(self.road, time, turn), self._come(self.road, time, turn)):
                groups.append(self._keep_free(others, in_lanes))
            groups.append(self._queue_up(self.road, time, turn))
        return Vehicles._make(np.concatenate(columns) for columns in zip(*groups, strict=True))

    def _keep_free(self, vehicles: Vehicles, others: Vehicles) -> Vehicles:
        """Leaves out the vehicles that would drive through something solid, or through others: the road is narrow there."""
        lengths, widths, _ = vehicles.sizes.T
        yaw = vehicles.poses[:, 2:]
        c, s = np.cos(yaw), np.sin(yaw)
        ahead = np.multiply.outer(lengths, [-0.4, 0.0, 0.4])
        points = vehicles.poses[:, None, :2] + np.stack([ahead * c, ahead * s], axis=-1)
        free = (self.solid.query(points)[0] > 0.5 * widths[:, None] + _ASIDE_M).all(axis=1)
        dx, dy = np.moveaxis(others.poses[:, :2] - vehicles.poses[:, None, :2], -1, 0)
        along, across = np.abs(c * dx + s * dy), np.abs(c * dy - s * dx)
        long, wide = (0.5 * np.add.outer(vehicles.sizes[:, k], others.sizes[:, k]) for k in (0, 1))
        free &= ~((along < long + _ASIDE_M) & (across < wide + _ASIDE_M)).any(axis=1)
        return Vehicles._make(column[free] for column in vehicles)

    def _in_lanes(self, time: float) -> Vehicles:
        """Returns the vehicles of the scene's lanes."""
        movers = self.scene.movers
        axes = np.column_stack([np.cos(movers[:, 2]), np.sin(movers[:, 2])])
        along = (movers[:, 4] + movers[:, 5] * time) % movers[:, 3]
        poses = np.column_stack([movers[:, :2] + along[:, None] * axes, movers[:, 2]])
        heights = np.where(movers[:, 6] > 6.0, TRUCK_HEIGHT, CAR_HEIGHT)
        sizes = np.column_stack([movers[:, 6:8], heights])
        return Vehicles(np.arange(len(movers)), poses, movers[:, 5:6] * axes, sizes)

    def _pace(self, road: _Road, time: float, turn: float) -> Vehicles:
        """Returns those that keep pace, at the distances that their drivers keep."""
        p = self.pacers
        now = np.interp(time, road.times, road.flow)
        here = np.flatnonzero((p.births < now) & (now < p.births + p.lives))
        p = _Pacers._make(column[here] for column in p)
        in_lane = np.abs(p.left) < 0.5 * LANE
        shortest = 7.0 + 0.5 * p.sizes[:, 0]
        places = []
        for t in (time, time + turn):
            flow = np.interp(t, road.times, road.flow)
            gap = p.gaps + p.closing * (flow - p.births - 0.5 * p.lives) + p.sways * np.sin(0.5 * flow + p.phases)
            sooner = np.interp(t + p.leads, road.times, road.reached) + gap
            own = np.interp(t, road.times, road.reached)
            ahead = np.maximum(sooner, own + shortest)  # nobody drives through the own vehicle
            behind = np.minimum(sooner, own - shortest)
            places.append(np.where(in_lane, np.where(p.gaps > 0.0, ahead, behind), sooner))
        return _between(road, 10_000 + here, places, p.left, p.sizes, turn)

    def _come(self, road: _Road, time: float, turn: float) -> Vehicles:
        """Returns the oncoming ones."""
        own = np.interp(time, road.times, road.reached)
        place = self.oncoming[:, 0] - self.realism.oncoming_mps * time
        here = np.flatnonzero(np.abs(place - own) < _IN_SIGHT_M)
        left, sizes = self.oncoming[here, 1], self.oncoming[here, 2:]
        towards = [place[here], place[here] - self.realism.oncoming_mps * turn]
        return _between(road, 20_000 + here, towards, left, sizes, turn)

    def _queue_up(self, road: _Road, time: float, turn: float) -> Vehicles:
        """Returns the queue, which keeps the very speed of the own vehicle for a minute."""
        places = []
        for t in (time, time + turn):
            off = max(_QUEUE_FROM_S - t, t - _QUEUE_FROM_S - _QUEUE_FOR_S, 0.0) * _QUEUE_LEAVES_MPS
            own = np.interp(t, road.times, road.reached)
            places.append(own + self.queue[:, 0] + np.sign(self.queue[:, 0]) * off)
        return _between(road, 30_000 + np.arange(len(self.queue)), places, self.queue[:, 1], self.queue[:, 2:], turn)


def make_traffic(
    scene: Scene,
    solid: Array,
    drive: Drive,
    duration_s: float,
    realism: Realism,
    seed: int,
    *,
    queue: bool = False,
) -> Traffic:
    """Makes the traffic of a drive: vehicles that pace it and oncoming ones, or a queue in their place.

    Args:
        scene: the scene.
        solid: (N, 2) places of what stands in it [m].
        drive: the own motion.
        duration_s: how long it takes [s].
        realism: how much traffic there is.
        seed: of it.
        queue: whether vehicles keep exact pace with the own one for a minute.
    """
    rng = np.random.default_rng([seed, 13])
    road = _find_road(drive, duration_s)
    flows = 0.0 if road is None or queue else road.flow[-1]
    pacers = _draw_pacers(rng, int(realism.pacing * flows / _PACER_S + 0.5), flows)
    ends = 0.0 if road is None or queue else road.reached[-1] + realism.oncoming_mps * duration_s + _IN_SIGHT_M
    gaps = rng.exponential(realism.oncoming_m, int(ends / realism.oncoming_m)) + 6.0
    lanes = 2.0 * LANE * np.where(rng.random(len(gaps)) < 0.8, 1.0, 2.0) + 0.2 * rng.standard_normal(len(gaps))
    oncoming = np.column_stack([np.cumsum(gaps), lanes, _draw_sizes(rng, len(gaps))])
    queued = _line_up(rng) if queue else np.empty((0, 5))
    return Traffic(scene, realism, road, pacers, oncoming, queued, cKDTree(solid))


def _find_road(drive: Drive, duration_s: float) -> _Road | None:
    """Returns the road that a drive follows, or None if it is on a yard."""
    times = np.arange(0.0, duration_s + 0.2, 0.1)
    poses = drive.poses(times)
    reached = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(poses[:, :2], axis=0).T))])
    if np.abs(np.diff(poses[:, 2])).sum() > _YARD * reached[-1]:
        return None
    speeds = np.gradient(reached, times)
    flow = np.concatenate([[0.0], np.cumsum(np.minimum(1.0, speeds / 4.0))[:-1]]) * 0.1
    moving = np.concatenate([[True], np.diff(reached) > 0.02])
    ahead = np.array([_BEYOND_M, 0.0, 0.0])
    ends = se2.compose(poses[[0, -1]], np.stack([-ahead, ahead]))
    places = np.concatenate([[-_BEYOND_M], reached[moving], [reached[-1] + _BEYOND_M]])
    return _Road(places, np.concatenate([ends[:1], poses[moving], ends[1:]]), times, reached, flow)


def _draw_pacers(rng: np.random.Generator, number: int, flows: float) -> _Pacers:
    """Draws vehicles that keep pace during a drive on which traffic flows for so many seconds."""
    in_lane = rng.random(number) < 0.6
    ahead = np.where(rng.random(number) < 0.5, -1.0, 1.0)
    gaps = ahead * np.where(in_lane, rng.uniform(8.0, 30.0, number), rng.uniform(0.0, 30.0, number))
    return _Pacers(
        births=rng.uniform(-_PACER_S, flows, number),
        lives=rng.uniform(0.5 * _PACER_S, 1.5 * _PACER_S, number),
        gaps=gaps,
        closing=rng.normal(0.0, 0.8, number),
        sways=rng.uniform(0.3, 2.0, number),
        phases=rng.uniform(-np.pi, np.pi, number),
        leads=np.clip(0.12 * gaps + rng.normal(0.0, 0.4, number), -3.0, 3.0),
        left=np.where(in_lane, 0.0, 2.0 * LANE) + rng.normal(0.0, 0.2, number),
        sizes=_draw_sizes(rng, number),
    )


def _draw_sizes(rng: np.random.Generator, number: int) -> Array:
    """Draws lengths, widths and heights (V, 3) [m] of vehicles, one in six of them a truck."""
    large = (rng.random(number) < _TRUCKS)[:, None]
    truck = np.column_stack([rng.uniform(6.0, 11.0, number), np.full(number, 2.5), np.full(number, TRUCK_HEIGHT)])
    car = np.column_stack([rng.normal(4.5, 0.3, number), np.full(number, 1.8), np.full(number, CAR_HEIGHT)])
    return np.where(large, truck, car)


def _line_up(rng: np.random.Generator) -> Array:
    """Lines up a queue (V, 5) before and behind the own vehicle, in its lane and the two to the left."""
    rows = []
    for lane in range(3):
        for sense in (-1.0, 1.0):
            sizes = _draw_sizes(rng, _QUEUE_LENGTH)
            lengths = sizes[:, 0]
            free = _OWN_M if lane == 0 else rng.uniform(0.0, _QUEUE_GAP_M)
            away = free + np.cumsum(lengths + _QUEUE_GAP_M) - 0.5 * lengths
            left = np.full(_QUEUE_LENGTH, lane * 2.0 * LANE)
            rows.append(np.column_stack([sense * away, left, sizes]))
    return np.concatenate(rows)


def _between(
    road: _Road, numbers: NDArray[np.int64], places: list[Array], left: Array, sizes: Array, turn: float
) -> Vehicles:
    """Returns vehicles that go from places along the road to other ones within a turn of so many seconds."""
    begins, ends = (road.at(place, left) for place in places)
    return Vehicles(numbers, begins, (ends[:, :2] - begins[:, :2]) / turn, sizes)


def outline(vehicles: Vehicles, realism: Realism, seed: int) -> Scatterers:
    """Lays scatterers along the outlines of vehicles; they stay where they are on a vehicle, whatever it does."""
    lengths, widths, heights = vehicles.sizes.T
    count = np.ceil(2.0 * (lengths + widths) / realism.spacing_m).astype(np.int64)
    which = np.repeat(np.arange(len(count)), count)
    number = np.arange(len(which)) - np.repeat(np.cumsum(count) - count, count)
    names = chance.name(vehicles.numbers[which], number, seed, VEHICLE)
    length, width = lengths[which], widths[which]
    way = (number + chance.uniform(names, 0)) / count[which] * 2.0 * (length + width)
    side = np.select([way < length, way < length + width, way < 2.0 * length + width], [0, 1, 2], 3)
    start = np.choose(side, [np.zeros(len(way)), length, length + width, 2.0 * length + width])
    share = (way - start) / np.where(side % 2 == 0, length, width)
    corners = CORNERS[side] + share[:, None] * (CORNERS[side + 1] - CORNERS[side])
    body = np.column_stack([corners * np.column_stack([length, width]), np.zeros(len(way))])
    yaw = vehicles.poses[which, 2]
    again = chance.name(names.view(np.int64), 1)
    normal = np.sqrt(2.0) * chance.complex_normal(again).real
    return Scatterers(
        places=se2.compose(vehicles.poses[which], body)[:, :2],
        velocities=vehicles.velocities[which],
        heights=0.25 + chance.uniform(names, 1) * (heights[which] - 0.25),
        normals=yaw + np.where(side % 2 == 0, 0.5 * np.pi, 0.0),
        materials=np.full(len(way), VEHICLE),
        levels=realism.vehicle_db + realism.spread_db * normal,
        names=names,
        blocks=chance.name(vehicles.numbers[which], np.floor(way / realism.block_m).astype(np.int64), seed, VEHICLE),
    )


def box_sides(vehicles: Vehicles) -> Array:
    """Returns the sides (4 V, 4) of vehicles as x0, y0, x1, y1 [m], four for each."""
    corners = CORNERS[None] * vehicles.sizes[:, None, :2]
    c, s = np.cos(vehicles.poses[:, 2])[:, None], np.sin(vehicles.poses[:, 2])[:, None]
    x = vehicles.poses[:, :1] + c * corners[..., 0] - s * corners[..., 1]
    y = vehicles.poses[:, 1:2] + s * corners[..., 0] + c * corners[..., 1]
    return np.stack([x[:, :-1], y[:, :-1], x[:, 1:], y[:, 1:]], axis=-1).reshape(-1, 4)
