"""An antenna that nobody places is found where the drive turns, as well as it says, and is else taken to be at the radar."""

from __future__ import annotations

import numpy as np
import pytest

from mqslam.backend.sensors.gnss import FixUse, join_fixes
from mqslam.backend.sensors.gnss_errors import Antenna, FixNoise, estimate_antenna
from mqslam.core import se2
from mqslam.core.measurement import Measurement
from mqslam.core.sensors import Fixes, TangentPlane

TURN_S, SCANS = 0.25, 1200
PLANE = TangentPlane(48.1, 11.5)
SOUND = FixNoise(0.3, 0.05)


def drive(turning: float, changing: float = 3.0) -> se2.Array:
    """Returns the poses (N, 3) of a drive whose speed changes, through turns of so many rad/s to both sides."""
    times = TURN_S * np.arange(SCANS - 1)
    speeds = 7.0 + changing * np.sin(times / 5.0)
    rates = turning * np.sin(times / 3.0) * (np.sin(times / 11.0) > 0.3)
    twists = np.column_stack([speeds, np.zeros_like(times), rates])
    return se2.integrate_steps(se2.exp(twists, np.full(len(times), TURN_S)))


def fix(poses: se2.Array, antenna: tuple[float, float], noise: FixNoise, seed: int, jump_m: float = 0.0) -> np.ndarray:
    """Returns fixes (F, 2), one per second, of which some jump."""
    rng, places = np.random.default_rng(seed), se2.compose(poses[::4], np.array([*antenna, 0.0]))[:, :2]
    walk = np.cumsum(rng.normal(0.0, noise.walk_m, places.shape), axis=0)
    positions = places + walk + rng.normal(0.0, noise.white_m, places.shape)
    positions[20::40] += jump_m
    return np.asarray(positions)


def estimate(poses: se2.Array, antenna: tuple[float, float], seed: int, jump_m: float = 0.0) -> Antenna:
    times = TURN_S * np.arange(SCANS)[::4]
    return estimate_antenna(times, poses[::4], fix(poses, antenna, SOUND, seed, jump_m), SOUND)


def join(antenna: tuple[float, float], turning: float) -> FixUse:
    poses = drive(turning)
    positions = fix(poses, antenna, SOUND, 1)
    latitudes, longitudes = PLANE.locate(positions).T
    stamps = np.round(1e6 * TURN_S * np.arange(SCANS)[::4]).astype(np.int64)
    fixes = Fixes(stamps, latitudes, longitudes, np.full(len(stamps), np.nan), "gnss.csv")
    covariance = np.diag([1e-4, 1e-4, 1e-6])
    motions = [
        Measurement(TURN_S * k, TURN_S * (k + 1), motion, covariance, on_map=True)
        for k, motion in enumerate(se2.between(poses[:-1], poses[1:]))
    ]
    return join_fixes(fixes, 0, motions, None)


def test_the_antenna_is_found_as_well_as_it_says() -> None:
    poses, antenna, scores = drive(0.35), (-1.5, 0.6), []
    for seed in range(6):
        found = estimate(poses, antenna, seed)
        scores.append((found.place - antenna) / found.sigmas)
        assert found.sigmas.max() < 0.3
    assert np.abs(scores).max() < 3.0 and np.sqrt(np.mean(np.square(scores))) > 0.2


def test_jumps_do_not_move_it() -> None:
    found = estimate(drive(0.35), (-1.5, 0.6), 1, jump_m=30.0)
    assert np.abs((found.place - [-1.5, 0.6]) / found.sigmas).max() < 3.0


def test_a_drive_without_turns_tells_nothing() -> None:
    found = estimate(drive(0.0), (-1.5, 0.6), 1)
    assert found.sigmas.min() > 1.5  # of the 2 m that are known beforehand


def test_at_constant_speed_a_late_clock_may_look_like_an_antenna_behind() -> None:
    steady, changing = (estimate(drive(0.35, changing), (-1.5, 0.6), 1).sigmas[0] for changing in (0.0, 3.0))
    assert steady > 2.0 * changing


def test_fixes_are_carried_from_an_antenna_that_they_show_elsewhere() -> None:
    use = join((-1.5, 0.6), 0.35)
    assert use.edges is not None and use.antenna is not None
    assert use.statements[0].startswith("the GNSS fixes show that the antenna sits 1.")
    assert "behind the radar" in use.statements[0]
    assert use.edges.noise.white_m < 0.36


@pytest.mark.parametrize(("antenna", "turning"), [((0.0, 0.0), 0.35), ((-1.5, 0.6), 0.0)])
def test_an_antenna_that_is_not_known_to_be_elsewhere_is_taken_to_be_at_the_radar(
    antenna: tuple[float, float], turning: float
) -> None:
    use = join(antenna, turning)
    assert use.edges is not None and not use.statements
