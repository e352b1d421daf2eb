"""The simulated radar: each azimuth of a polar scan is rendered from the sensor's pose at the time of this azimuth."""

from __future__ import annotations

from dataclasses import asdict, dataclass

import numpy as np
from numpy.typing import NDArray

from mqslam.core import se2
from mqslam.errors import ConfigError
from mqslam.simulator.beam import COUNTS_PER_DECADE, Pattern, SimulatedRadar, Sweep, Things, render_power
from mqslam.simulator.scene import Scene

ENCODER = 5600
"""Encoder steps per revolution, clockwise, as the Oxford layout stores azimuths."""
_MOST_READINGS = 64_000_000  # largest number of azimuths times range bins: readers accept no larger images
_LARGEST_FAULTS = {"bin_error": 0.5, "azimuth_offset_deg": 180.0, "late_s": 10.0}  # larger faults are mistakes
_PATTERN_WIDTHS = 3.0  # width of all cells of a beam together [beam widths]: outside, the gain is negligible


@dataclass(frozen=True)
class SensorModel:
    """A clockwise spinning radar that stores power in half decibels; the defaults are a Navtech CTS350-X.

    Args:
        turn_rate_hz: revolutions per second.
        azimuths: azimuths per revolution.
        range_resolution: length of a range bin [m].
        max_range: largest range at which the last bin may end [m].
        beam_width_deg: one-way half-power width of the beam.
        cells: number of thin parts into which the beam is cut, over three beam widths.
        spread_bins: standard deviation of an echo along the range [bins].
        wall_level: echo of a wall at right angles to the beam, 10 m away [counts of half a decibel].
        pole_level: echo of a lamp post in the middle of the beam, 10 m away [counts].
        noise_level: mean thermal noise [counts]; 0 means no noise.
        speckle: share of an echo's power that fluctuates, 0..1.
        roughness: standard deviation of a surface's depth [m].
        saturation_probability: probability that the noise of an azimuth is 15 to 25 dB higher.
        clutter_probability: probability that a bin holds a clutter echo, which nothing in the scene causes.
        doppler_beta: range shift per closing speed [s]: measured range = true range - doppler_beta * closing speed.
        chirps: whether chirps go up and down alternately, up at the first azimuth; a chirp that goes down has the opposite
            range shift.
        range_offset: true range of an object at rest minus the range of the centre of its bin [m].
        bin_error: share by which a range bin is truly longer than `range_resolution`, which the recording states.
        azimuth_offset_deg: direction of the beam when the encoder is at zero, counter-clockwise from straight ahead [deg].
        late_s: by how much every stamp of the radar is later than the instant that it stands for [s].

    Raises:
        ConfigError: a parameter is outside its range.
    """

    turn_rate_hz: float = 4.0
    azimuths: int = 400
    range_resolution: float = 0.0438
    max_range: float = 165.0
    beam_width_deg: float = 1.8
    cells: int = 12
    spread_bins: float = 0.7
    wall_level: float = 125.0
    pole_level: float = 115.0
    noise_level: float = 18.0
    speckle: float = 0.7
    roughness: float = 0.03
    saturation_probability: float = 0.01
    clutter_probability: float = 5e-5
    doppler_beta: float = 0.0
    chirps: bool = False
    range_offset: float = 0.0
    bin_error: float = 0.0
    azimuth_offset_deg: float = 0.0
    late_s: float = 0.0

    def __post_init__(self) -> None:
        positive = ("turn_rate_hz", "range_resolution", "max_range", "beam_width_deg", "spread_bins")
        for name in positive:
            if not (np.isfinite(getattr(self, name)) and getattr(self, name) > 0.0):
                raise ConfigError(f"simulator: {name} is {getattr(self, name)}; it must be a finite number above 0")
        for name, largest in _LARGEST_FAULTS.items():
            if not abs(getattr(self, name)) <= largest:
                raise ConfigError(f"simulator: {name} is {getattr(self, name)}; choose {-largest:g} to {largest:g}")
        if not 4 <= self.azimuths <= ENCODER:
            raise ConfigError(f"simulator: azimuths is {self.azimuths}; choose 4 to {ENCODER}")
        if self.turn_rate_hz * self.azimuths > 1e6:  # stamps are whole microseconds
            raise ConfigError(
                f"simulator: turn_rate_hz is {self.turn_rate_hz}: {self.azimuths} azimuths take under 1 us each; lower it"
            )
        if self.bins < 8:
            raise ConfigError(f"simulator: a max_range of {self.max_range} m holds only {self.bins} range bins; raise it")
        if self.bins * self.azimuths > _MOST_READINGS:
            problem = f"{self.azimuths} azimuths of {self.bins} range bins are more readings than {_MOST_READINGS}"
            raise ConfigError(f"simulator: {problem}; lower max_range or the number of azimuths, or use longer bins")

    @property
    def bins(self) -> int:
        """Number of range bins per azimuth: all that end within `max_range`."""
        return int(self.max_range / self.range_resolution + 1e-9)

    @property
    def rising(self) -> NDArray[np.bool_]:
        """Mask (A,) of the azimuths whose chirp goes up: all azimuths or, with alternating chirps, every other one."""
        return np.asarray((np.arange(self.azimuths) % 2 == 0) | (not self.chirps))

    @property
    def betas(self) -> NDArray[np.float64]:
        """Range shift per closing speed (A,) [s] of each azimuth, with the opposite sign where the chirp goes down."""
        return np.where(self.rising, self.doppler_beta, -self.doppler_beta)

    @property
    def encoders(self) -> NDArray[np.int64]:
        """Encoder steps (A,) clockwise from straight ahead, rounded as a recording stores them."""
        return np.round(np.arange(self.azimuths) * ENCODER / self.azimuths).astype(np.int64)

    @property
    def angles(self) -> NDArray[np.float64]:
        """Azimuths (A,) [rad] that a recording states: 0 down to almost -2 pi, one clockwise revolution."""
        return np.asarray(-2.0 * np.pi / ENCODER * self.encoders)

    @property
    def directions(self) -> NDArray[np.float64]:
        """True directions (A,) [rad] of the beam at the azimuths in `angles`, counter-clockwise from straight ahead."""
        return np.asarray(self.angles + np.deg2rad(self.azimuth_offset_deg))

    @property
    def late_us(self) -> int:
        """The delay `late_s` of all stamps in whole microseconds."""
        return round(self.late_s * 1e6)

    @property
    def bin_length(self) -> float:
        """True length of a range bin [m]."""
        return self.range_resolution * (1.0 + self.bin_error)

    def describe(self) -> dict[str, float]:
        """Returns the parameters by name; a fault, such as `late_s`, is left out where it is zero."""
        return {name: value for name, value in asdict(self).items() if value or name not in _LARGEST_FAULTS}


def render_polar_scan(
    scene: Scene,
    poses: se2.Array,
    twists: se2.Array,
    times: NDArray[np.float64],
    sensor: SensorModel,
    seed: int | tuple[int, ...],
) -> NDArray[np.uint8]:
    """Renders the received power (A, B) of one polar scan; bin b is centred at (b + 0.5) bin lengths plus the range offset.

    Args:
        scene: the things that reflect.
        poses: (A, 3) pose of the sensor at each azimuth in the scene's frame [m, m, rad].
        twists: (A, 3) body velocity of the sensor at each azimuth: forward [m/s], left [m/s], yaw rate [rad/s].
        times: (A,) time of each azimuth [s]; it determines where moving vehicles are.
        sensor: the radar.
        seed: seed of the noise of this polar scan; the same seed gives the same bytes.

    Returns:
        Counts (A, B) uint8, half a decibel each.
    """
    width = np.deg2rad(sensor.beam_width_deg)
    borders = np.linspace(-0.5 * _PATTERN_WIDTHS * width, 0.5 * _PATTERN_WIDTHS * width, sensor.cells + 1)
    gains = np.exp(-8.0 * np.log(2.0) * (0.5 * (borders[1:] + borders[:-1]) / width) ** 2)
    radar = SimulatedRadar(
        sensor.bins,
        sensor.bin_length,
        sensor.spread_bins,
        _to_power(sensor.wall_level),
        _to_power(sensor.pole_level),
        _to_power(sensor.noise_level) if sensor.noise_level > 0.0 else 0.0,
        sensor.speckle,
        sensor.roughness,
        sensor.saturation_probability,
        sensor.clutter_probability,
        sensor.range_offset,
    )
    power = render_power(
        _keep_near(scene, poses, sensor.bins * sensor.bin_length),
        Sweep(np.ascontiguousarray(poses), np.ascontiguousarray(twists), times, sensor.directions, sensor.betas),
        Pattern(np.c_[np.sin(borders), np.cos(borders)], gains / gains.sum(), width),
        radar,
        np.random.SeedSequence(seed).generate_state(1)[0],
    )
    return np.asarray(power)


def _keep_near(scene: Scene, poses: se2.Array, max_range: float) -> Things:
    """Returns a scene without most of the walls, poles and plants farther than `max_range` [m] from all poses (A, 3).

    The beams would not reach these things; without them, rendering is faster.
    """
    middle = poses[len(poses) // 2, :2]
    reach = max_range + np.hypot(*(poses[:, :2] - middle).T).max() + 2.0  # the margin covers the size of any thing
    starts, along = scene.walls[:, :2], scene.walls[:, 2:4] - scene.walls[:, :2]
    squared = np.maximum((along**2).sum(axis=1), np.finfo(float).tiny)
    share = np.clip(((middle - starts) * along).sum(axis=1) / squared, 0.0, 1.0)
    walls = np.hypot(*(starts + share[:, None] * along - middle).T) < reach
    poles, plants = (np.hypot(*(things[:, :2] - middle).T) for things in (scene.poles, scene.plants))
    return Things(
        scene.walls[walls],
        scene.poles[poles < reach],
        scene.movers,
        scene.plants[plants < reach + scene.plants[:, 2]],
    )


def _to_power(level: float) -> float:
    """Returns the linear power of a level in counts of half a decibel."""
    return float(10.0 ** (level / COUNTS_PER_DECADE))
