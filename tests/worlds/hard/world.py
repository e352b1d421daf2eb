"""The hard world of a drive: all that its turns share, and how one of them is rendered."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from worlds.hard.echoes import Beams, Echoes, add_echoes, bounce, draw_strays
from worlds.hard.hiding import NEAREST_M, Obstacles, Passed, cast_shadows, make_rays, to_depths
from worlds.hard.radar import JitteringClock, Suspension, attenuate, make_clock, make_suspension, receive
from worlds.hard.realism import USUAL, Realism
from worlds.hard.scatterers import (
    PLANT,
    Scatterers,
    change_with_aspect,
    fluctuate,
    glint,
    is_vehicle,
    join,
    lay_ground,
    look_about,
    plant_heights,
    sample_scene,
    wall_heights,
)
from worlds.hard.traffic import Traffic, Vehicles, box_sides, make_traffic, outline

from mqslam.simulator.drive import Drive
from mqslam.simulator.scene import Array, Scene
from mqslam.simulator.sensor import SensorModel

_REFERENCE_M = 20.0  # range at which levels are stated
_FAINTEST = 0.02  # power below which an echo cannot be seen, even if it fades up
_MARGIN_M = 5.0  # by which the last range bin is exceeded, since things and the radar move


@dataclass(frozen=True)
class HardWorld:
    """A drive through a scene whose radar recordings are as hard as real ones; `make_hard_world` makes one."""

    scene: Scene  # what reflects and hides
    drive: Drive  # how the radar moves
    sensor: SensorModel  # turn rate, azimuths, range bins, beam width and the radar's faults count; the rest is `realism`'s
    realism: Realism  # the magnitudes of all effects
    seed: int  # of everything
    scatterers: Scatterers  # of the scene, in the order of their x
    standing: Obstacles  # what hides and does not move
    traffic: Traffic  # what moves
    suspension: Suspension  # how the own vehicle tilts
    clock: JitteringClock  # when azimuths are measured and stamped

    def stamps(self, k: int) -> Array:
        """Returns the times (A,) [s] at which the azimuths of turn k are said to be measured."""
        return self.clock.stamps(k)

    def end(self) -> float:
        """Returns the time [s] at which the last turn is said to end."""
        borders = self.clock.borders
        return float(self.stamps(len(borders) - 2)[0] + (borders[-1] - borders[-2]))

    def describe(self) -> dict[str, Any]:
        """Returns what the parameters of a written recording say of this world."""
        return {"realism": "hard", "effects": asdict(self.realism)} | ({"queue": True} if len(self.traffic.queue) else {})

    def render(self, k: int) -> NDArray[np.uint8]:
        """Renders the readings (A, B) uint8 of turn k; they do not depend on which other turns are rendered."""
        times = self.clock.times(k)
        poses = self.drive.poses(times)
        beams = self._aim(times, poses)
        turn = float(self.clock.borders[k + 1] - self.clock.borders[k])
        vehicles = self._look_around(self.traffic.vehicles(float(times[0]), turn), poses)
        rays = make_rays(poses, self.sensor.directions, beams.times)
        passed = cast_shadows(self._obstruct(vehicles), rays, self._reach())
        echoes, names = self._reflect(k, times, poses, vehicles, passed)
        rng = np.random.default_rng([self.seed, 16, k])
        field = np.zeros((self.sensor.azimuths, self.sensor.bins), dtype=np.complex128)
        add_echoes(echoes, beams, field)
        add_echoes(bounce(echoes, names, poses[len(poses) // 2, :2], self.realism), beams, field)
        add_echoes(draw_strays(rng, poses, self.sensor.directions, self.realism), beams, field)
        return receive(field, self.sensor.bin_length, self.realism, rng)

    def _look_around(self, vehicles: Vehicles, poses: Array) -> Vehicles:
        """Returns the vehicles near enough to be seen in a turn with poses (A, 3)."""
        near = np.hypot(*(vehicles.poses[:, :2] - poses[len(poses) // 2, :2]).T) < self._reach()
        return Vehicles._make(column[near] for column in vehicles)

    def _reach(self) -> float:
        """Returns the range [m] beyond which nothing is seen."""
        return self.sensor.bins * self.sensor.bin_length + _MARGIN_M

    def _aim(self, times: Array, poses: Array) -> Beams:
        """Returns the beams of a turn from its times (A,) [s] and poses (A, 3)."""
        twists = self.drive.twists(times)
        c, s = np.cos(poses[:, 2]), np.sin(poses[:, 2])
        return Beams(
            poses=np.column_stack([poses[:, :2], poses[:, 2] + self.sensor.directions]),
            velocities=np.column_stack([c * twists[:, 0] - s * twists[:, 1], s * twists[:, 0] + c * twists[:, 1]]),
            times=times - times[0],
            width=float(np.deg2rad(self.sensor.beam_width_deg)),
            foot=self.realism.foot,
            foot_widths=self.realism.foot_widths,
            resolution=self.sensor.bin_length,
            betas=self.sensor.betas,
            offset=self.sensor.range_offset,
        )

    def _obstruct(self, vehicles: Vehicles) -> Obstacles:
        """Returns what hides during a turn: the scene and the vehicles about."""
        realism, standing, sides = self.realism, self.standing, box_sides(vehicles)
        tall = np.repeat(vehicles.sizes[:, 2] > realism.radar_height_m, 4)
        return standing._replace(
            sides=np.concatenate([standing.sides, sides]),
            velocities=np.concatenate([standing.velocities, np.repeat(vehicles.velocities, 4, axis=0)]),
            depths=np.concatenate([standing.depths, np.full(len(sides), _vehicle_depth(realism))]),
            tall=np.concatenate([standing.tall, tall]),
        )

    def _reflect(
        self, k: int, times: Array, poses: Array, vehicles: Vehicles, passed: Passed
    ) -> tuple[Echoes, NDArray[np.uint64]]:
        """Returns the direct echoes of turn k, and the names of their scatterers.

        Args:
            k: number of the turn.
            times: (A,) of its azimuths [s].
            poses: (A, 3) of the radar at them.
            vehicles: what moves.
            passed: what passes along rays.
        """
        realism = self.realism
        middle = poses[len(poses) // 2, :2]
        known = look_about(self.scatterers, middle, self._reach())
        ground = lay_ground((float(middle[0]), float(middle[1])), realism, self.seed)
        seen = join(known, ground, outline(vehicles, realism, self.seed))
        azimuths = _face(seen, times - times[0], poses + np.array([0.0, 0.0, self.sensor.directions[0]]))
        at = np.rint(azimuths).astype(np.int64) % len(poses)
        lines = poses[at, :2] - seen.places - seen.velocities * (times[at] - times[0])[:, None]
        ranges = np.maximum(np.hypot(*lines.T), 1e-3)
        tips = self.suspension.tip(times, self.sensor.directions)[at]
        elevations = np.arctan((seen.heights - realism.radar_height_m) / ranges) - tips
        aspects = np.arctan2(lines[:, 1], lines[:, 0]) - seen.normals
        level = seen.levels - attenuate(elevations, realism)
        power = 10.0 ** (level / 10.0) * (_REFERENCE_M / ranges) ** realism.range_law
        power *= passed.to(azimuths, ranges, seen.heights > realism.radar_height_m) * glint(seen, aspects, realism)
        kept = np.flatnonzero((power > _FAINTEST) & (ranges > NEAREST_M))
        seen = seen.choose(kept)
        offsets, fades = change_with_aspect(seen, aspects[kept], realism)
        amplitudes = np.sqrt(power[kept]) * fluctuate(seen, fades, realism, k)
        return Echoes(seen.places + offsets, seen.velocities, amplitudes, at[kept]), seen.names


def make_hard_world(
    scene: Scene,
    drive: Drive,
    sensor: SensorModel,
    turns: int,
    seed: int,
    *,
    realism: Realism = USUAL,
    queue: bool = False,
) -> HardWorld:
    """Makes the hard world of a drive through a scene: its scatterers, traffic, tilt and clock.

    Args:
        scene: what reflects and hides.
        drive: how the radar moves.
        sensor: the radar.
        turns: how often it turns.
        seed: of everything.
        realism: the magnitudes of all effects.
        queue: whether vehicles keep exact pace with the radar for a minute, in the place of all other traffic.
    """
    clock = make_clock(turns, sensor.turn_rate_hz, sensor.azimuths, realism, seed)
    scatterers = sample_scene(scene, realism, seed)
    solid = scatterers.places[scatterers.materials != PLANT]
    return HardWorld(
        scene=scene,
        drive=drive,
        sensor=sensor,
        realism=realism,
        seed=seed,
        scatterers=scatterers,
        standing=_stand_in_the_way(scene, realism),
        traffic=make_traffic(scene, solid, drive, float(clock.borders[-1]), realism, seed, queue=queue),
        suspension=make_suspension(drive, realism, seed),
        clock=clock,
    )


def _stand_in_the_way(scene: Scene, realism: Realism) -> Obstacles:
    """Returns what of a scene hides: its walls, its parked vehicles and its plants."""
    walls, plants, height = scene.walls, scene.plants, realism.radar_height_m
    return Obstacles(
        sides=walls[:, :4],
        velocities=np.zeros((len(walls), 2)),
        depths=np.where(is_vehicle(scene), _vehicle_depth(realism), realism.wall_depth * to_depths(walls[:, 5])),
        tall=wall_heights(scene) > height,
        crowns=np.column_stack([plants[:, :3], to_depths(plants[:, 3])]),
        tall_crowns=plant_heights(scene) > height,
    )


def _vehicle_depth(realism: Realism) -> float:
    """Returns the optical depth of a side of a vehicle."""
    return float(to_depths(np.array(realism.vehicle_opacity)))


def _face(scatterers: Scatterers, times: Array, poses: Array) -> Array:
    """Returns the numbers (N,) of the azimuths, with fractions, at which the beam of a turn meets scatterers.

    Args:
        scatterers: (N,) at the start of the turn.
        times: (A,) of the azimuths since then [s].
        poses: (A, 3) of the radar at them, whose headings are those of the beam at the first azimuth.
    """
    count = len(times)
    at = np.zeros(len(scatterers.names), dtype=np.intp)
    azimuths = np.zeros(len(at))
    for _ in range(3):  # the radar and the scatterers move little during a turn, so this settles at once
        lines = scatterers.places + scatterers.velocities * times[at][:, None] - poses[at, :2]
        bearings = poses[at, 2] - np.arctan2(lines[:, 1], lines[:, 0])
        azimuths = bearings % (2.0 * np.pi) / (2.0 * np.pi) * count
        at = np.rint(azimuths).astype(np.intp) % count
    return azimuths
