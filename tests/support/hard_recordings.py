"""Small recordings with what breaks an estimator: nothing to see, one thing to see, gaps, odd radars.

The world is a set of points, the sensor drives along x, and returns are built directly, so that a recording costs
milliseconds. `RecordingInMemory` draws the same returns as power, for what needs a detector or a file.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mqslam.config import Config, SensorConfig
from mqslam.core.frontend import Context
from mqslam.core.recording import PolarScan, Recording
from mqslam.core.scans import Returns, Scan, Scans
from mqslam.core.trajectory import Trajectory
from mqslam.execution.local_engine import HERE
from mqslam.formats.recordings.native import write as write_native
from mqslam.formats.tum import write_tum
from mqslam.psi.doppler import choose_doppler
from mqslam.slam import Slam
from mqslam.solution import Solution

START_US = 1_700_000_000_000_000
SPEED = 5.0  # of a drive [m/s]
TURN_S = 0.25
NOISE_M = 0.05  # of a range

Points = NDArray[np.float64]
Way = Callable[[NDArray[np.float64]], NDArray[np.float64]]  # x [m] at times [s]


def poles(count: int = 220, side_m: float = 120.0, seed: int = 1) -> Points:
    """Returns poles (N, 2) [m] strewn around the origin."""
    return np.random.default_rng(seed).uniform(-0.5 * side_m, 0.5 * side_m, (count, 2))


def bare_walls() -> Points:
    """Returns two bare walls (N, 2) [m] along x, 6 m to either side."""
    x = np.arange(-100.0, 100.0)
    return np.concatenate([np.column_stack([x, np.full(len(x), side)]) for side in (-6.0, 6.0)])


def straight_on(times: NDArray[np.float64]) -> NDArray[np.float64]:
    """Returns the distances driven at `SPEED` [m]."""
    return SPEED * times


def at_rest(times: NDArray[np.float64]) -> NDArray[np.float64]:
    """Returns the distances driven at rest: zero."""
    return np.zeros_like(times)


def scan(
    world: Points,
    t0: float,
    way: Way = straight_on,
    turn_s: float = TURN_S,
    noise_m: float = NOISE_M,
    reach_m: tuple[float, float] = (2.5, 80.0),
    seed: int = 0,
) -> Scan:
    """Returns what a clockwise radar on a drive sees of a world in the turn that begins at t0 [s]."""
    rng = np.random.default_rng([seed, round(t0 * 1e6)])
    times = np.full(len(world), t0)
    for _ in range(5):  # a point is seen when the beam points at it, and it lies where it does then
        offsets = world - np.column_stack([way(times), np.zeros(len(world))])
        share = (-np.arctan2(offsets[:, 1], offsets[:, 0]) % (2.0 * np.pi)) / (2.0 * np.pi)
        times = t0 + share * turn_s
    ranges = np.hypot(*offsets.T)
    order = np.argsort(times, kind="stable")
    order = order[(ranges[order] > reach_m[0]) & (ranges[order] < reach_m[1])]
    measured = ranges[order] + rng.normal(0.0, noise_m, len(order))
    returns = Returns(measured, -2.0 * np.pi * share[order], times[order], rng.uniform(90.0, 120.0, len(order)))
    return Scan(t0, t0 + turn_s, returns)


def drive(
    scans: int,
    world: Points | None = None,
    way: Way = straight_on,
    turn_s: float = TURN_S,
    missing: Sequence[int] = (),
    noise_m: float = NOISE_M,
    reach_m: tuple[float, float] = (2.5, 80.0),
) -> list[Scan]:
    """Returns successive scans of a world; those of numbers in `missing` are left out."""
    world = poles() if world is None else world
    return [scan(world, k * turn_s, way, turn_s, noise_m, reach_m) for k in range(scans) if k not in missing]


def without_returns(scans: Sequence[Scan], which: range) -> list[Scan]:
    """Returns the same scans, those of numbers in `which` without returns."""
    return [replace(w, returns=Returns.none()) if k in which else w for k, w in enumerate(scans)]


def thin(scans: Sequence[Scan], count: int, which: range, seed: int = 0) -> list[Scan]:
    """Returns the same scans, those of numbers in `which` with at most `count` of their returns."""
    result = list(scans)
    for k in which:
        chosen = np.zeros(len(scans[k].returns), dtype=bool)
        chosen[np.random.default_rng([seed, k]).permutation(len(chosen))[:count]] = True
        result[k] = replace(scans[k], returns=scans[k].returns.take(chosen))
    return result


def repeated(scan: Scan, scans: int) -> list[Scan]:
    """Returns one scan again and again, at successive times, as a sensor with a stuck driver delivers it."""
    late = (scan.t1 - scan.t0) * np.arange(scans)
    return [Scan(scan.t0 + t, scan.t1 + t, replace(scan.returns, times=scan.returns.times + t)) for t in late.tolist()]


def one_spot(scans: int) -> list[Scan]:
    """Returns scans whose returns all are one and the same."""
    first = Returns(*(np.full(40, value) for value in (10.0, -1.0, 0.04, 99.0)))
    return repeated(Scan(0.0, TURN_S, first), scans)


def one_direction(scans: int) -> list[Scan]:
    """Returns scans whose returns all lie straight ahead, exactly."""
    return drive(scans, np.column_stack([np.linspace(3.0, 300.0, 150), np.zeros(150)]), noise_m=0.0)


def around_the_sensor(scans: int, range_m: float) -> list[Scan]:
    """Returns scans whose returns all have one range, in all directions."""
    azimuths = np.linspace(0.0, -6.2, 60)
    times = -azimuths / (2.0 * np.pi) * TURN_S
    first = Returns(np.full(60, range_m), azimuths, times, np.full(60, 99.0))
    return repeated(Scan(0.0, TURN_S, first), scans)


def farther(scans: Sequence[Scan], by_m: float) -> list[Scan]:
    """Returns the same scans with every return farther away."""
    return [replace(w, returns=replace(w.returns, ranges=w.returns.ranges + by_m)) for w in scans]


def parked_among_cars(scans: int) -> list[Scan]:
    """Returns scans of a parked sensor that cars pass; forty of two hundred returns are theirs."""
    still, cars = poles(160, 100.0), poles(40, 100.0, seed=2)
    result = []
    for k in range(scans):
        moving = cars + np.array([8.0 * TURN_S * k, 0.0])
        moving[:, 0] = (moving[:, 0] + 50.0) % 100.0 - 50.0
        result.append(scan(np.concatenate([still, moving]), k * TURN_S, at_rest))
    return result


def into_a_tunnel(scans: int, way: Way = straight_on) -> list[Scan]:
    """Returns a drive past poles into a bare tunnel; after two seconds hardly a pole is left in reach."""
    before = np.random.default_rng(3).uniform((-60.0, -30.0), (5.0, 30.0), (80, 2))
    walls = bare_walls()
    return drive(scans, np.concatenate([before, walls[walls[:, 0] > 5.0]]), way, reach_m=(2.5, 30.0))


def braking(times: NDArray[np.float64]) -> NDArray[np.float64]:
    """Returns the distances driven [m] at `SPEED` by a vehicle that brakes from the second to the fourth second."""
    late = np.clip(times - 2.0, 0.0, 2.0)
    return SPEED * (np.minimum(times, 2.0) + late - 0.25 * late**2)


def joined(scans: Sequence[Scan]) -> Scans:
    """Returns the scans as those of one recording that begins at stamp 0."""
    return Scans(tuple(scans), 0, scans[0].t1 - scans[0].t0)


def stamps_of(scans: Sequence[Scan]) -> NDArray[np.int64]:
    """Returns the stamps (N,) [us] of the beginnings of the scans, counted from their time zero."""
    return np.array([round(w.t0 * 1e6) for w in scans], dtype=np.int64)


def truth_of(scans: Sequence[Scan], way: Way = straight_on) -> NDArray[np.float64]:
    """Returns the true poses (N, 3) at the beginnings of the scans."""
    return np.column_stack([way(np.array([w.t0 for w in scans])), np.zeros((len(scans), 2))])


def solve(
    scans: Sequence[Scan],
    frontend: str = "psi",
    config: Config | None = None,
    odometry: Trajectory | None = None,
    doppler_beta: float | None = 0.0,
) -> Solution:
    """Finds the trajectory by a front end and the graph; where the Doppler shift is None, psi measures it."""
    config = (config or Config()).model_copy(update={"sensor": SensorConfig(doppler_beta=doppler_beta)})
    together = joined(scans)
    beta = choose_doppler(together, config, HERE).beta
    context = Context(config, together.revolution_s, 0, odometry, beta)
    return Slam(config, frontend).solve(together, context)


def errors_of(solution: Solution, scans: Sequence[Scan], way: Way = straight_on) -> NDArray[np.float64]:
    """Returns the errors (N - 1, 3) [m, m, rad] of the measurements of a drive straight ahead."""
    steps = np.diff(truth_of(scans, way), axis=0)
    return np.array([m.pose for m in solution.measurements]) - steps


def normalised(solution: Solution, errors: NDArray[np.float64]) -> NDArray[np.float64]:
    """Returns the squared errors (N - 1,) in units of their covariances: chi-squares of 3 degrees of freedom if right."""
    covariances = np.array([m.covariance for m in solution.measurements])
    return np.asarray(np.einsum("ni,nij,nj->n", errors, np.linalg.inv(covariances), errors))


def assert_sound(solution: Solution) -> None:
    """Checks that poses are finite, and that covariances are finite, symmetric and positive definite."""
    assert np.isfinite(solution.optimised.poses).all()
    assert np.isfinite(solution.odometry.poses).all()
    for m in solution.measurements:
        assert np.isfinite(m.pose).all()
        assert np.isfinite(m.covariance).all()
        np.testing.assert_allclose(m.covariance, m.covariance.T, rtol=1e-9, atol=1e-15)
        sigmas = np.sqrt(np.diag(m.covariance))
        assert np.linalg.eigvalsh(m.covariance / np.outer(sigmas, sigmas))[0] > 1e-12, m


@dataclass(frozen=True, kw_only=True)
class RecordingInMemory(Recording):
    """Scans as the power that a radar would have measured; a return lights `width` azimuths to either side as well."""

    scans: tuple[Scan, ...]
    azimuths: int
    bins: int
    width: int

    def polar_scans(self, start: int = 0, stop: int | None = None) -> Iterator[PolarScan]:
        shares = np.arange(self.azimuths) / self.azimuths
        for k in range(len(self))[start:stop]:
            scan, length = self.scans[k], self.scans[k].t1 - self.scans[k].t0
            power = np.random.default_rng(k).integers(0, 11, (self.azimuths, self.bins)).astype(np.uint8)
            rows = np.round((scan.returns.times - scan.t0) / length * self.azimuths).astype(int)
            columns = (scan.returns.ranges / self.range_resolution).astype(int)
            inside = columns < self.bins
            for aside in range(-self.width, self.width + 1):
                lit = np.clip(rows[inside] + aside, 0, self.azimuths - 1)
                power[lit, columns[inside]] = 200 - 40 * abs(aside) // self.width
            times = scan.t0 + shares * length
            yield PolarScan(times, -2.0 * np.pi * shares, power, np.ones(self.azimuths, dtype=bool))


def recorded(
    scans: Sequence[Scan], azimuths: int = 400, bins: int = 400, bin_m: float = 0.25, width: int = 1
) -> RecordingInMemory:
    """Returns the scans as a recording."""
    return RecordingInMemory(
        path=Path("in memory"),
        format="native",
        stamps_us=START_US + stamps_of(scans),
        turns_us=np.array([round((s.t1 - s.t0) * 1e6) for s in scans], dtype=np.int64),
        range_resolution=bin_m,
        scans=tuple(scans),
        azimuths=azimuths,
        bins=bins,
        width=width,
    )


def write(folder: Path, scans: Sequence[Scan]) -> tuple[Path, Path]:
    """Writes a native recording of scans and a trajectory file of the true poses, up to the recording's end."""
    folder.mkdir(parents=True, exist_ok=True)
    recording = recorded(scans)
    write_native(folder / "drive.npz", recording)
    stamps = np.append(recording.stamps_us, recording.end_us)
    way = np.column_stack([straight_on((stamps - START_US) * 1e-6), np.zeros((len(stamps), 2))])
    write_tum(folder / "truth.tum", Trajectory(stamps, way))
    return folder / "drive.npz", folder / "truth.tum"


SCANS = 14  # of a hard recording, if nothing else is said
HARD: dict[str, Callable[[], Sequence[Scan]]] = {
    "no return in any scan": lambda: without_returns(drive(SCANS), range(SCANS)),
    "one return in every scan": lambda: thin(drive(SCANS), 1, range(SCANS)),
    "two returns in every scan": lambda: thin(drive(SCANS), 2, range(SCANS)),
    "seven returns in every scan": lambda: thin(drive(SCANS), 7, range(SCANS)),
    "twenty returns in every scan": lambda: thin(drive(SCANS), 20, range(SCANS)),
    "forty returns in every scan": lambda: thin(drive(SCANS), 40, range(SCANS)),
    "one return from the seventh scan on": lambda: thin(drive(SCANS), 1, range(6, SCANS)),
    "two returns from the seventh scan on": lambda: thin(drive(SCANS), 2, range(6, SCANS)),
    "three returns from the seventh scan on": lambda: thin(drive(SCANS), 3, range(6, SCANS)),
    "three scans without returns": lambda: without_returns(drive(SCANS), range(5, 8)),
    "first scan without returns": lambda: without_returns(drive(SCANS), range(1)),
    "first two scans without returns": lambda: without_returns(drive(SCANS), range(2)),
    "first three scans without returns": lambda: without_returns(drive(SCANS), range(3)),
    "returns in the first scan only": lambda: without_returns(drive(SCANS), range(1, SCANS)),
    "returns in the last scan only": lambda: without_returns(drive(SCANS), range(SCANS - 1)),
    "one scan again and again": lambda: repeated(drive(1)[0], SCANS),
    "one return again and again": lambda: one_spot(SCANS),
    "all returns in one direction": lambda: one_direction(SCANS),
    "all returns at the sensor": lambda: around_the_sensor(SCANS, 0.0),
    "all returns at one range": lambda: around_the_sensor(SCANS, 20.0),
    "all returns beyond a kilometre": lambda: farther(drive(SCANS), 1000.0),
    "bare walls": lambda: drive(SCANS, bare_walls()),
    "bare walls without noise": lambda: drive(SCANS, bare_walls(), noise_m=0.0),
    "into a tunnel": lambda: into_a_tunnel(24),
    "a full stop in a tunnel": lambda: into_a_tunnel(24, braking),
    "a gap after one scan": lambda: drive(16, missing=range(1, 9)),
    "a gap after two scans": lambda: drive(16, missing=range(2, 10)),
    "a gap of a minute": lambda: [*drive(6), *drive(300, missing=range(294))],
    "two scans": lambda: drive(2),
    "one scan": lambda: drive(1),
    "ten turns per second": lambda: drive(24, turn_s=0.1),
}

AT_REST = {name for name in HARD if "again" in name or name in ("all returns at the sensor", "all returns at one range")}
