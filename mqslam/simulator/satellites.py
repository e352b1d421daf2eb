"""A GNSS receiver on the vehicle: its fixes scatter, jump where houses reflect the signals, and are missing at times."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mqslam.core.sensors import Fixes
from mqslam.simulator.drive import Drive

ORIGIN_DEG = (51.76, -1.26)
"""Latitude and longitude of the scene's origin, of which x points east and y north: Oxford."""
_EQUATOR_M, _FLATTENING = 6_378_137.0, 1.0 / 298.257223563
"""Semi-major axis and flattening of the ellipsoid of WGS 84."""


@dataclass(frozen=True)
class ReceiverModel:
    """Errors of a receiver of one frequency, such as the u-blox M8 and M9, of which half the fixes lie within 2 to 2.5 m.

    Args:
        rate_hz: fixes per second.
        noise_m: standard deviation of a fix along each axis [m]; the receiver states it, whatever its error is.
        jumps: multipath jumps per minute.
        jump_m: standard deviation of a jump along each axis [m]: a wall on the other side of a street reflects the signals.
        jump_s: mean duration of a jump [s].
        outages: outages per minute.
        outage_s: mean duration of an outage [s]: a bridge or a street that is narrow.
    """

    rate_hz: float = 1.0
    noise_m: float = 2.0
    jumps: float = 1.0
    jump_m: float = 20.0
    jump_s: float = 4.0
    outages: float = 0.5
    outage_s: float = 6.0


def simulate_fixes(
    drive: Drive, roofs: NDArray[np.float64], duration_s: float, start_us: int, model: ReceiverModel, seed: int
) -> Fixes:
    """Simulates the fixes of a receiver at the radar's place during a drive.

    Args:
        drive: the true motion.
        roofs: (R, 4) of the scene, under which there are no fixes.
        duration_s: how long the drive takes [s].
        start_us: stamp [us] of time zero.
        model: errors of the receiver.
        seed: of the errors.
    """
    rng = np.random.default_rng([seed, 22])
    times = np.arange(int(np.floor(duration_s * model.rate_hz + 1e-9)) + 1) / model.rate_hz
    true = drive.poses(times)[:, :2]
    places = true + model.noise_m * rng.standard_normal((len(times), 2))
    for begin, end in _draw_spells(rng, duration_s, model.jumps, model.jump_s):
        places[(times >= begin) & (times < end)] += model.jump_m * rng.standard_normal(2)
    seen = np.ones(len(times), dtype=np.bool_)
    for begin, end in _draw_spells(rng, duration_s, model.outages, model.outage_s):
        seen &= (times < begin) | (times >= end)
    for roof in roofs:
        seen &= ~np.all((roof[:2] <= true) & (true <= roof[2:]), axis=1)
    latitudes, longitudes = _find_degrees(places[seen])
    stamps_us = start_us + np.round(times[seen] * 1e6).astype(np.int64)
    return Fixes(stamps_us, latitudes, longitudes, np.full(len(stamps_us), model.noise_m), "simulated")


def _draw_spells(rng: np.random.Generator, duration_s: float, per_minute: float, mean_s: float) -> list[tuple[float, float]]:
    """Draws spells of a mean duration [s] at random times: their beginnings and ends [s]."""
    begins = rng.uniform(0.0, duration_s, rng.poisson(per_minute * duration_s / 60.0))
    return list(zip(begins.tolist(), (begins + rng.exponential(mean_s, len(begins))).tolist(), strict=True))


def _find_degrees(places: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Returns latitudes (N,) and longitudes (N,) [deg] of places (N, 2) [m] in the plane that touches the origin.

    The radii of curvature are those at the origin: ten kilometres away this is wrong by some metres.
    """
    latitude, longitude = ORIGIN_DEG
    squared = _FLATTENING * (2.0 - _FLATTENING)
    bulge = 1.0 - squared * np.sin(np.deg2rad(latitude)) ** 2
    across = _EQUATOR_M / np.sqrt(bulge)
    north, east = across * (1.0 - squared) / bulge, across * np.cos(np.deg2rad(latitude))
    return latitude + np.rad2deg(places[:, 1] / north), longitude + np.rad2deg(places[:, 0] / east)
