"""The detect stage carries velocities along: through workers, checkpoints and polar scans that cannot be read."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

import numpy as np
import pytest

from mqslam.config import DetectorConfig
from mqslam.core.recording import PolarScan, Recording
from mqslam.core.velocity import Outcome, Velocities
from mqslam.detection import stage
from mqslam.detection.detector import detect
from mqslam.detection.stage import detect_all, detect_stretch
from mqslam.errors import DataError
from mqslam.execution.checkpoint import Checkpoint
from mqslam.execution.local_engine import LocalEngine
from mqslam.execution.runner import Runner
from mqslam.formats.recordings import open_recording
from mqslam.formats.recordings.derived import DerivedRecording, copy_fields
from mqslam.simulator import (
    CHIRP_BETA,
    ConstantDrive,
    SensorModel,
    SimulatedRecording,
    make_yard_scene,
    simulate,
    simulate_recording,
)

SENSOR = SensorModel(azimuths=200, range_resolution=0.175, max_range=60.0, doppler_beta=CHIRP_BETA, chirps=True)
DETECTOR = DetectorConfig()


@lru_cache(maxsize=1)
def drive() -> SimulatedRecording:
    return simulate_recording(make_yard_scene(1), ConstantDrive(6.0, 0.2), duration_s=2.5, sensor=SENSOR)


def assert_equal(one: Velocities | None, other: Velocities | None) -> None:
    assert one is not None and other is not None
    for name in ("times", "velocities", "covariances", "outcomes"):
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name))
        assert getattr(one, name).dtype == getattr(other, name).dtype


def detect_velocities(recording: Recording, runner: Runner | None = None) -> Velocities:
    velocities = detect_all(recording, DETECTOR, runner, with_velocities=True)[1].velocities
    assert velocities is not None
    return velocities


def test_every_scan_has_the_velocity_of_its_middle() -> None:
    velocities = detect_velocities(drive())
    assert velocities.measured.all() and not velocities.reasons
    np.testing.assert_allclose(velocities.times, drive().start_times + 0.125)
    np.testing.assert_allclose(velocities.velocities, np.tile([6.0, 0.0], (10, 1)), atol=0.3)


def test_returns_are_those_of_the_up_chirps_alone() -> None:
    detected = detect_stretch(drive(), DETECTOR, 0, 2, with_velocities=True)
    for turn, returns in zip(drive().polar_scans(0, 2), detected.returns, strict=True):
        alone = detect(PolarScan(turn.times, turn.azimuths, turn.power, turn.valid), SENSOR.range_resolution, DETECTOR)
        np.testing.assert_array_equal(returns.ranges, alone.ranges)
        np.testing.assert_array_equal(returns.times, alone.times)


def test_velocities_are_measured_only_where_they_are_asked_for_and_chirps_alternate() -> None:
    assert detect_all(drive(), DETECTOR)[1].velocities is None
    plain = SensorModel(azimuths=200, range_resolution=0.175, max_range=60.0)
    recording = simulate_recording(make_yard_scene(1), ConstantDrive(6.0, 0.2), duration_s=0.5, sensor=plain)
    assert detect_all(recording, DETECTOR, with_velocities=True)[1].velocities is None


def test_workers_do_not_change_them(monkeypatch: pytest.MonkeyPatch) -> None:
    alone = detect_velocities(drive())
    monkeypatch.setattr(stage, "_CHUNK", 3)
    assert_equal(detect_velocities(drive(), Runner(LocalEngine(2))), alone)


@pytest.mark.parametrize("with_velocities", [True, False])
def test_a_resumed_run_finds_them_in_its_checkpoint(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, with_velocities: bool
) -> None:
    def run(resume: bool) -> Velocities | None:
        runner = Runner(checkpoint=Checkpoint(tmp_path / "out", "key", resume=resume))
        return detect_all(drive(), DETECTOR, runner, with_velocities=with_velocities)[1].velocities

    monkeypatch.setattr(stage, "_CHUNK", 4)
    made = run(resume=False)
    monkeypatch.setattr(stage, "detect_stretch", lambda *_, **__: pytest.fail("detected again"))
    if with_velocities:
        assert_equal(run(resume=True), made)
    else:
        assert made is None and run(resume=True) is None


@pytest.fixture
def written(tmp_path: Path) -> Path:
    simulate(tmp_path / "drive", scene="yard", duration_s=1.5, sensor=SENSOR)
    return tmp_path / "drive"


def cut_images(folder: Path, first: int, last: int) -> None:
    for image in sorted((folder / "radar").iterdir())[first:last]:
        image.write_bytes(image.read_bytes()[:100])


def test_a_polar_scan_that_cannot_be_read_measures_none(written: Path, caplog: pytest.LogCaptureFixture) -> None:
    cut_images(written, 2, 3)
    with caplog.at_level("INFO", "mqslam.detection.stage"):
        velocities = detect_velocities(open_recording(written))
    assert velocities.reasons == {Outcome.UNREAD.reason: 1}
    assert np.flatnonzero(~velocities.measured).tolist() == [2] and np.isnan(velocities.velocities[2]).all()
    assert "5 of 6 scans measured the velocity; 1 did not: the polar scan could not be read" in caplog.text


def test_a_stretch_of_which_nothing_can_be_read_joins_the_others(written: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    cut_images(written, 2, 4)
    monkeypatch.setattr(stage, "_CHUNK", 2)
    velocities = detect_velocities(open_recording(written))
    assert velocities.measured.tolist() == [True, True, False, False, True, True]


def test_a_stretch_has_the_velocities_that_the_whole_recording_has() -> None:
    whole, part = detect_velocities(drive()), detect_stretch(drive(), DETECTOR, 4, 7, with_velocities=True).velocities
    arrays = (a[4:7] for a in (whole.times, whole.velocities, whole.covariances, whole.outcomes))
    assert_equal(part, Velocities(*arrays))


@dataclass(frozen=True, kw_only=True)
class Own(DerivedRecording):
    """A recording whose polar scans somebody has made."""

    make: Callable[[PolarScan], PolarScan]

    def _change(self, polar_scan: PolarScan) -> PolarScan:
        return self.make(polar_scan)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"stamps_us": drive().stamps_us / 1e6}, r"its stamps_us must be an array \(10,\) of int64, but they are float64"),
        ({"stamps_us": drive().stamps_us[::-1]}, "its stamps_us do not increase at polar scan 1"),
        ({"turns_us": drive().turns_us[:3]}, r"its turns_us must be an array \(10,\) of int64, but they are int64 \(3,\)"),
        ({"turns_us": 250_000}, "its turns_us must be an array .* but they are int"),
        ({"turns_us": 0 * drive().turns_us}, "its turns_us are 0 at polar scan 0"),
        ({"range_resolution": float("nan")}, "its range_resolution is nan"),
    ],
)
def test_a_recording_of_ones_own_whose_index_is_wrong_is_refused(change: dict, said: str) -> None:
    with pytest.raises(DataError, match=said):
        detect_all(replace(drive(), **change), DETECTOR)


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (lambda p: replace(p, times=1e6 * p.times), "polar scan 0: its times go from .* give times in seconds"),
        (lambda p: replace(p, azimuths=np.degrees(p.azimuths)), "polar scan 0: its azimuths span .*; give them in radians"),
        (lambda p: replace(p, azimuths=p.azimuths[:-3]), r"polar scan 0: its times, azimuths, .* \(100,\), \(97,\)"),
        (lambda p: replace(p, power=p.power.T), r"give \(A,\), \(A,\), \(A, B\) and \(A,\)"),
    ],
)
def test_a_polar_scan_of_ones_own_that_is_wrong_is_refused(make: Callable[[PolarScan], PolarScan], said: str) -> None:
    own = Own(inner=drive(), make=make, **copy_fields(drive()))
    with pytest.raises(DataError, match=said):
        detect_all(own, DETECTOR)


def test_recordings_are_equal_only_to_themselves() -> None:
    own = Own(inner=drive(), make=lambda p: p, **copy_fields(drive()))
    assert own == own and own != replace(own) and len({own, drive()}) == 2
