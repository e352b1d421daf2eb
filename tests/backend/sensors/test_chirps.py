"""Velocities that agree with psi become motions, are put right where they err all the time, or are refused and said."""

from __future__ import annotations

import re
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import pytest

from mqslam.backend.sensors.chirps import SIGMA_SCALE, VelocityUse, join_velocities
from mqslam.core import se2
from mqslam.core.measurement import Measurement, Status
from mqslam.core.velocity import Outcome, Velocities

TURN_S, SCANS = 0.25, 400
SIGMA_MPS, SIGMAS = 0.05, np.array([0.02, 0.01, 1e-3])


class Chirps(NamedTuple):
    """Velocities by their errors."""

    scale: float = 1.0
    bias: tuple[float, float] = (0.0, 0.0)
    wild: float = 0.0


def twists() -> se2.Array:
    """Returns a drive that speeds up, slows down and turns (N, 3)."""
    k = np.arange(SCANS)
    return np.column_stack((8.0 + 3.0 * np.sin(k / 40.0), 0.02 * np.cos(k / 25.0), 0.1 * np.sin(k / 30.0)))


def measured(scans: int = SCANS) -> list[Measurement]:
    """Returns the motions of the drive as psi measures them."""
    noise = np.random.default_rng(1).normal(0.0, SIGMAS, (SCANS, 3))
    poses = se2.exp(twists(), np.full(SCANS, TURN_S)) + noise
    return [Measurement(TURN_S * k, TURN_S * (k + 1), poses[k], np.diag(SIGMAS**2), on_map=True) for k in range(scans - 1)]


def velocities(chirps: Chirps, scans: int = SCANS) -> Velocities:
    """Returns what the chirps say of the drive, once per scan."""
    rng = np.random.default_rng(2)
    told = chirps.scale * twists()[:scans, :2] + np.array(chirps.bias) + rng.normal(0.0, SIGMA_MPS, (scans, 2))
    told += chirps.wild * rng.normal(0.0, 1.0, (scans, 2))
    spread = np.tile(SIGMA_MPS**2 * np.eye(2), (scans, 1, 1))
    times = TURN_S * (np.arange(scans) + 0.5)
    return Velocities(times, told, spread, np.full(scans, Outcome.MEASURED, dtype=np.int64))


def joined(chirps: Chirps) -> VelocityUse:
    return join_velocities(velocities(chirps), measured())


def test_sound_velocities_become_motions_that_say_nothing_of_the_turn() -> None:
    use = joined(Chirps())
    assert use.statements == (f"the velocities from the chirps are used, {SCANS - 1} of them",)
    assert use.edges is not None
    off = np.array([edge.pose for edge in use.edges.values()]) - se2.exp(twists(), np.full(SCANS, TURN_S))[:-1]
    variances = np.array([np.diag(edge.covariance) for edge in use.edges.values()])
    np.testing.assert_array_less(np.sqrt(np.mean(off[:, :2] ** 2, axis=0)), 2.0 * SIGMA_MPS * TURN_S)
    assert 0.3 < np.mean(off[:, :2] ** 2 / variances[:, :2]) < 1.2  # what all of them share widens each
    assert variances[:, 2].min() > np.pi**2
    assert use.scale == pytest.approx(1.0, abs=4.0 * use.sigma_scale) and use.sigma_scale < 0.01


@pytest.mark.parametrize("chirps", [Chirps(scale=0.9), Chirps(scale=1.08), Chirps(bias=(0.2, -0.15))])
def test_what_is_wrong_all_the_time_is_put_right(chirps: Chirps) -> None:
    use = joined(chirps)
    assert use.edges is not None
    off = np.array([edge.pose for edge in use.edges.values()]) - se2.exp(twists(), np.full(SCANS, TURN_S))[:-1]
    np.testing.assert_array_less(np.abs(off[:, :2].mean(axis=0)), 0.01)
    far = "small" if chirps.scale < 1.0 else "large"
    scaled = [s for s in use.statements if re.search(rf"are \d+\.\d% too {far}, which is put right", s)]
    assert len(scaled) == (chirps.scale != 1.0), use.statements


@pytest.mark.parametrize(
    ("chirps", "why"),
    [
        (Chirps(scale=2.0), "0.5 times as far as the velocities say; the Doppler shift of its chirps may be wrong"),
        (Chirps(scale=-1.0), "the Doppler shift of its chirps may be wrong"),
    ],
)
def test_velocities_that_contradict_the_map_are_refused_and_said(chirps: Chirps, why: str) -> None:
    use = joined(chirps)
    assert use.edges is None and len(use.statements) == 1
    assert use.statements[0].startswith("the velocities from the chirps are not used: ") and why in use.statements[0]


def test_velocities_that_are_noisier_than_they_state_count_as_little_as_they_show() -> None:
    sound, noisy = joined(Chirps()), joined(Chirps(wild=0.5))
    assert sound.edges is not None and noisy.edges is not None
    assert noisy.edges[100].covariance[0, 0] > 30.0 * sound.edges[100].covariance[0, 0]


def test_where_psi_found_too_few_motions_velocities_are_as_good_as_they_state() -> None:
    lost = [replace(motion, status=Status.DEGENERATE) for motion in measured()]
    use = join_velocities(velocities(Chirps()), lost)
    assert use.edges is not None and len(use.edges) == SCANS - 1
    relative = np.sqrt(use.edges[100].covariance[0, 0]) / use.edges[100].pose[0]
    assert relative > SIGMA_SCALE * 0.9


def test_scans_without_a_velocity_on_both_sides_make_no_motion() -> None:
    told = velocities(Chirps())
    outcomes = told.outcomes.copy()
    outcomes[-3:] = Outcome.DARK
    use = join_velocities(replace(told, outcomes=outcomes), measured())
    assert use.edges is not None and sorted(use.edges) == list(range(SCANS - 3))
