"""Where a front end did not find every motion, it is asked again with what a gyroscope says of the turn."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace
from typing import ClassVar

import numpy as np
import pytest
from support.bends import START_US, TURN_S, Unit, measured, read, yaw_at

from mqslam.backend.measuring import measure
from mqslam.config import Config, SensorConfig
from mqslam.core import frontend
from mqslam.core.frontend import Context
from mqslam.core.measurement import Measurement, Status
from mqslam.core.scans import Returns, Scan, Scans
from mqslam.core.sensors import Gyroscope, Sensors
from mqslam.core.trajectory import Trajectory
from mqslam.execution.runner import Runner
from mqslam.psi.place import beam_of

COUNT = 400
SCANS = Scans(tuple(Scan(TURN_S * k, TURN_S * (k + 1), Returns.none()) for k in range(COUNT)), START_US, TURN_S)
BLIND = range(200, 230)


class HalfBlind:
    """A front end that finds the turn of no scan in a stretch, and says there what it is told."""

    takes_turning = True
    asked: ClassVar[list[Context]] = []

    def __init__(self, context: Context) -> None:
        self.asked.append(context)

    def measure(self, scans: Iterable[Scan]) -> Iterator[Measurement]:
        """Yields the motions of a drive through bends."""
        list(scans)
        context = self.asked[-1]
        for k, motion in enumerate(measured(COUNT)):
            if k in BLIND:
                told = context.told_twist(motion.t0, motion.t1)
                turn = 0.0 if told is None or np.isnan(told[2]) else told[2] * TURN_S
                yield replace(motion, pose=np.array([2.0, 0.0, turn]), status=Status.DEGENERATE)
            else:
                yield motion


class Sighted(HalfBlind):
    """A front end that finds every motion."""

    def measure(self, scans: Iterable[Scan]) -> Iterator[Measurement]:
        """Yields the motions of a drive through bends."""
        list(scans)
        yield from measured(COUNT)


class Deaf(HalfBlind):
    """A front end that does not say that it takes what a gyroscope tells."""

    takes_turning = False


def ask(
    kind: type[HalfBlind],
    gyroscope: Gyroscope | None,
    monkeypatch: pytest.MonkeyPatch,
    odometry: Trajectory | None = None,
) -> tuple[list[Measurement], int]:
    """Returns the motions, and how often the front end was asked for them."""
    monkeypatch.setattr(frontend, "load", lambda _: kind)
    monkeypatch.setattr(HalfBlind, "asked", [])
    config = Config(sensor=SensorConfig(doppler_beta=0.0))
    context = Context(config, TURN_S, START_US, odometry, sensors=Sensors(gyroscope))
    motions = list(measure("any", SCANS, context, beam_of(config.estimator, 0.0), Runner()))
    return motions, len(HalfBlind.asked)


def test_odometry_that_contradicts_the_radar_tells_a_blind_stretch_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    times = TURN_S * np.arange(COUNT + 1)
    poses = np.column_stack([8.0 * times, np.zeros(COUNT + 1), -yaw_at(times)])
    odometry = Trajectory(START_US + np.round(1e6 * times).astype(np.int64), poses)
    motions, asked = ask(HalfBlind, None, monkeypatch, odometry)
    assert asked == 2 and turned(motions) == 0.0


def turned(motions: list[Measurement]) -> float:
    """Returns how far the motions of the blind stretch turn [rad]."""
    return float(sum(motions[k].pose[2] for k in BLIND))


def test_a_stretch_that_shows_no_turn_gets_the_gyroscopes(monkeypatch: pytest.MonkeyPatch) -> None:
    motions, times = ask(HalfBlind, read(Unit(), COUNT * TURN_S), monkeypatch)
    assert times == 2 and len(motions) == COUNT - 1
    true = turned(measured(COUNT))
    assert abs(true) > 0.3 and turned(motions) == pytest.approx(true, abs=0.02)
    assert {motions[k].status for k in BLIND} == {Status.DEGENERATE}


@pytest.mark.parametrize(
    ("kind", "gyroscope"),
    [
        (Sighted, read(Unit(), COUNT * TURN_S)),
        (Deaf, read(Unit(), COUNT * TURN_S)),
        (HalfBlind, read(Unit(wild=0.5), COUNT * TURN_S)),
        (HalfBlind, None),
    ],
    ids=["all motions are found", "it takes none", "it contradicts the radar", "there is none"],
)
def test_elsewhere_the_front_end_is_asked_once(
    kind: type[HalfBlind], gyroscope: Gyroscope | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    motions, times = ask(kind, gyroscope, monkeypatch)
    assert times == 1 and len(motions) == COUNT - 1
