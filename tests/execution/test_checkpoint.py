"""What a run has computed survives its death to the last bit, and nothing wrong is taken for it."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.commands import read_contents
from support.drives import constant

from mqslam import slam as slam_module
from mqslam.config import Config, MapConfig, SensorConfig
from mqslam.core.measurement import Loop, LoopSearch, Measured, Measurement, Refined, Status
from mqslam.core.scans import Returns
from mqslam.core.trajectory import Trajectory
from mqslam.core.velocity import Detected
from mqslam.detection.stage import detect_all
from mqslam.errors import DataError, OutputError, Remedy
from mqslam.execution.checkpoint import Checkpoint, hash_run, keep_checkpoint
from mqslam.execution.folders import CHECKPOINT
from mqslam.execution.kept import LOOPS, MEASURED, REFINED, Kept, describe_kept_stretch
from mqslam.execution.runner import Runner
from mqslam.psi import doppler as doppler_module
from mqslam.simulator import SensorModel, SimulatedRecording, make_street_scene, simulate_recording
from mqslam.slam import Slam

RNG = np.random.default_rng(1)


def some_returns(count: int) -> Returns:
    return Returns(*(RNG.normal(size=count) for _ in range(4)))


RETURNS = [some_returns(7), some_returns(0), some_returns(1), some_returns(30), some_returns(0)]
DETECTED = Detected(RETURNS, {4: DataError("drive/radar/4.png", "is not a readable PNG", "copy it anew")})
MEASUREMENTS = [
    Measurement(0.0, 0.25, RNG.normal(size=3), np.cov(RNG.normal(size=(3, 9))), Status.CONVERGED, 12.3, 14.0, 812, 0.83),
    Measurement(0.25, 0.5, RNG.normal(size=3), np.cov(RNG.normal(size=(3, 9))), Status.DEGENERATE, 1.0 / 3.0),
    Measurement(0.5, 0.75, RNG.normal(size=3), np.cov(RNG.normal(size=(3, 9))), Status.AMBIGUOUS),
    Measurement(0.75, 1.0, RNG.normal(size=3), np.cov(RNG.normal(size=(3, 9))), Status.LOST, points=3),
]
CLOSURES = [
    Loop(3, 170, RNG.normal(size=3), RNG.normal(size=(3, 3)), 0.71, 0.2),
    Loop(9, 180, np.zeros(3), np.eye(3), 1.0, 0.1),
]
REFINEMENT = Refined(
    CLOSURES[:1], [*CLOSURES[1:], Loop(4, 171, np.ones(3), np.eye(3), 0.6, 0.3)], 0.9, 0.4, 0.3, refused=True
)
STRETCH = describe_kept_stretch(0, 5)
RESULTS: list[tuple[Kept[Any], Any]] = [
    (STRETCH, DETECTED),
    (MEASURED, Measured(MEASUREMENTS, 0.0489)),
    (LOOPS, LoopSearch(CLOSURES, 17, 5, 4, 3, 2)),
    (REFINED, REFINEMENT),
]
FILES = tuple(kept.file for kept, _ in RESULTS)


def filled(out: Path, key: str = "this run") -> Checkpoint:
    """Returns a checkpoint with every stage."""
    checkpoint = Checkpoint(out, key, resume=False)
    for kept, result in RESULTS:
        checkpoint.keep(kept, result)
    return checkpoint


def resumed(out: Path) -> Checkpoint:
    return Checkpoint(out, "this run", resume=True)


def found_in(checkpoint: Checkpoint) -> list[Any]:
    return [checkpoint.find(kept) for kept, _ in RESULTS]


def assert_same(one: Any, other: Any) -> None:
    """Checks that two results are equal bit by bit, NaN included, whatever dataclasses and sequences they are made of."""
    if is_dataclass(one):
        for f in fields(one):
            assert_same(getattr(one, f.name), getattr(other, f.name))
    elif isinstance(one, np.ndarray):
        np.testing.assert_array_equal(one, other)
        assert one.dtype == other.dtype and other.flags.c_contiguous
    elif isinstance(one, Sequence) and not isinstance(one, str):
        for part, same in zip(one, other, strict=True):
            assert_same(part, same)
    else:
        assert type(one) is type(other) and repr(one) == repr(other)


@pytest.mark.parametrize(("kept", "result"), [*RESULTS, (LOOPS, LoopSearch([], 4)), (REFINED, Refined([], []))])
def test_every_result_survives_a_round_trip(tmp_path: Path, kept: Kept[Any], result: Any) -> None:
    filled(tmp_path / "out").keep(kept, result)
    assert_same(result, resumed(tmp_path / "out").find(kept))


def test_nothing_is_there_before_it_is_kept_and_looking_makes_nothing(tmp_path: Path) -> None:
    for resume in (False, True):
        assert found_in(Checkpoint(tmp_path / "out", "this run", resume=resume)) == [None] * len(FILES)
    assert read_contents(tmp_path) == {}
    filled(tmp_path / "out")
    others = [describe_kept_stretch(*span) for span in ((0, 4), (5, 10))]
    assert [resumed(tmp_path / "out").find(other) for other in others] == [None, None]


@pytest.mark.parametrize("name", FILES)
def test_a_file_that_is_cut_short_is_not_there(tmp_path: Path, name: str) -> None:
    filled(tmp_path / "out")
    file = tmp_path / "out" / CHECKPOINT / name
    whole = file.read_bytes()
    for length in [*range(0, len(whole), 101), len(whole) - 1]:
        file.write_bytes(whole[:length])
        kept = found_in(resumed(tmp_path / "out"))
        assert [part is None for part in kept] == [other == name for other in FILES], length


@pytest.mark.parametrize("name", FILES)
def test_a_file_with_a_broken_byte_is_not_there_or_as_it_was(tmp_path: Path, name: str) -> None:
    checkpoint = filled(tmp_path / "out")
    file = tmp_path / "out" / CHECKPOINT / name
    whole, right = file.read_bytes(), found_in(checkpoint)[FILES.index(name)]
    missing = 0
    for place in range(0, len(whole), 13):
        broken = bytearray(whole)
        broken[place] ^= 0x55
        file.write_bytes(broken)
        kept = found_in(resumed(tmp_path / "out"))[FILES.index(name)]
        missing += kept is None
        if kept is not None:
            assert_same(right, kept)
    assert missing > 20


@pytest.mark.parametrize("other", [b"", b"no archive", "loops.npz"])
def test_something_else_under_the_name_is_not_there(tmp_path: Path, other: bytes | str) -> None:
    filled(tmp_path / "out")
    folder = tmp_path / "out" / CHECKPOINT
    text = other if isinstance(other, bytes) else (folder / other).read_bytes()
    for name in FILES[:2]:
        (folder / name).write_bytes(text)
    assert found_in(resumed(tmp_path / "out"))[:2] == [None, None]


@pytest.fixture(scope="module")
def recording() -> SimulatedRecording:
    """Forty-four polar scans, which are detected in two stretches."""
    sensor = SensorModel(turn_rate_hz=8.0, azimuths=200, range_resolution=0.175, max_range=60.0)
    return simulate_recording(make_street_scene(1, movers=0), constant(6.0, 0.0), duration_s=5.5, sensor=sensor)


def test_a_broken_stretch_is_detected_again(recording: SimulatedRecording, tmp_path: Path) -> None:
    config = Config().detector
    checkpoint = Checkpoint(tmp_path / "out", "this run", resume=False)
    first, _ = detect_all(recording, config, Runner(checkpoint=checkpoint))
    before = read_contents(tmp_path)
    kept = sorted((tmp_path / "out" / CHECKPOINT).glob("returns-*"))
    assert len(kept) == 2
    for broken in ([], kept[:1], kept[1:], kept):
        for file in broken:
            file.write_bytes(file.read_bytes()[:500])
        again, cost = detect_all(recording, config, Runner(checkpoint=resumed(tmp_path / "out")))
        assert (cost.read_s > 0.0) == bool(broken)
        for one, other in zip(first, again, strict=True):
            assert (one.t0, one.t1) == (other.t0, other.t1)
            assert_same(one.returns, other.returns)
        assert read_contents(tmp_path).keys() == before.keys()


def test_a_resumed_run_repeats_no_finished_stage_and_ends_the_same(
    recording: SimulatedRecording, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The Doppler shift, which is measured, is kept with the measurements made with it."""
    monkeypatch.setattr(doppler_module, "measure_doppler", lambda *_: doppler_module.Doppler(0.0123, 0.0045))
    config = Config(map=MapConfig(cell_m=2.0))
    first = Slam(config, "psi", Runner(checkpoint=Checkpoint(tmp_path / "out", "this run", resume=False))).run(
        recording, None
    )
    monkeypatch.setattr(doppler_module, "measure_doppler", lambda *_: pytest.fail("measured again"))
    monkeypatch.setattr(slam_module, "find_loops", lambda *_: pytest.fail("searched again"))
    monkeypatch.setattr(SimulatedRecording, "polar_scans", lambda *_: pytest.fail("read again"))
    again = Slam(config, "psi", Runner(checkpoint=resumed(tmp_path / "out"))).run(recording, None)
    assert again.config == first.config and again.doppler_beta == first.doppler_beta == 0.0123
    assert again.doppler_sigma == first.doppler_sigma == 0.0045
    np.testing.assert_array_equal(again.optimised.poses, first.optimised.poses)
    np.testing.assert_array_equal(again.map_optimised.psi, first.map_optimised.psi)
    for one, other in zip(first.measurements, again.measurements, strict=True):
        assert_same(one, other)


def test_another_runs_checkpoint_is_refused_and_left(tmp_path: Path) -> None:
    filled(tmp_path / "out", "another run")
    before = read_contents(tmp_path)
    with pytest.raises(OutputError, match=r"unfinished run of other data or settings; choose another output"):
        resumed(tmp_path / "out")
    with pytest.raises(OutputError), keep_checkpoint(tmp_path / "out", "this run", resume=True):
        pass
    assert read_contents(tmp_path) == before


@pytest.mark.parametrize("text", ["", "[]", "{}", '{"key": 3}'])
def test_a_checkpoint_that_does_not_say_whose_it_is_is_refused(tmp_path: Path, text: str) -> None:
    filled(tmp_path / "out")
    (tmp_path / "out" / CHECKPOINT / "run.json").write_text(text)
    with pytest.raises(OutputError):
        resumed(tmp_path / "out")


def test_a_run_that_died_before_it_kept_anything_can_be_resumed(tmp_path: Path) -> None:
    (tmp_path / "out" / CHECKPOINT).mkdir(parents=True)
    (tmp_path / "out" / CHECKPOINT / ".run.json.x1y2").write_text('{"k')
    assert found_in(resumed(tmp_path / "out")) == [None] * len(FILES)


def test_a_new_run_clears_what_an_old_one_kept_and_nothing_else(tmp_path: Path) -> None:
    filled(tmp_path / "out")
    (tmp_path / "out" / "mine").write_text("kept")
    assert found_in(Checkpoint(tmp_path / "out", "this run", resume=False)) == [None] * len(FILES)
    assert read_contents(tmp_path) == {"out": None, "out/mine": b"kept"}


def test_every_stage_is_written_whole_or_not_at_all(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    checkpoint = filled(tmp_path / "out")
    before = read_contents(tmp_path)

    def dies(file: Any, **arrays: Any) -> None:
        file.write(b"half of")
        raise KeyboardInterrupt

    monkeypatch.setattr(np, "savez", dies)
    with pytest.raises(KeyboardInterrupt):
        checkpoint.keep(LOOPS, LoopSearch([], 0))
    assert read_contents(tmp_path) == before


@pytest.mark.parametrize("earlier", [{}, {"out": None, "out/mine": b"kept"}], ids=["nothing", "a result"])
def test_an_error_of_the_user_leaves_what_was_there(tmp_path: Path, earlier: dict[str, bytes | None]) -> None:
    for name, content in earlier.items():
        (tmp_path / name).mkdir() if content is None else (tmp_path / name).write_bytes(content)
    with pytest.raises(DataError), keep_checkpoint(tmp_path / "out", "this run", resume=False) as checkpoint:
        checkpoint.keep(STRETCH, DETECTED)
        raise DataError("drive", "is broken")
    assert read_contents(tmp_path) == earlier


@pytest.mark.parametrize("resume", [False, True])
@pytest.mark.parametrize(
    ("error", "is_advised"),
    [
        (KeyboardInterrupt(), True),
        (MemoryError(), True),
        (OSError(28, "No space left on device"), True),
        (OutputError("the disk is full"), True),
        (ValueError("the same again"), False),
        (np.linalg.LinAlgError("the same again"), False),
    ],
    ids=repr,
)
def test_resuming_is_advised_unless_the_same_would_happen_again(
    tmp_path: Path, error: BaseException, is_advised: bool, resume: bool
) -> None:
    with pytest.raises(type(error)) as raised, keep_checkpoint(tmp_path / "out", "this run", resume=resume) as checkpoint:
        checkpoint.keep(LOOPS, LoopSearch(CLOSURES, 17))
        raise error
    assert (str(Remedy.RESUME) in getattr(raised.value, "__notes__", [])) == is_advised
    assert resumed(tmp_path / "out").find(LOOPS) is not None


@pytest.mark.parametrize("name", ["run.json", LOOPS.file])
def test_a_pipe_in_a_checkpoint_is_not_waited_for(tmp_path: Path, name: str) -> None:
    filled(tmp_path / "out")
    (tmp_path / "out" / CHECKPOINT / name).unlink()
    os.mkfifo(tmp_path / "out" / CHECKPOINT / name)
    if name == "run.json":
        with pytest.raises(OutputError, match="unfinished run of other data"):
            resumed(tmp_path / "out")
    else:
        assert resumed(tmp_path / "out").find(LOOPS) is None


def test_an_error_while_resuming_keeps_what_was_there(tmp_path: Path) -> None:
    filled(tmp_path / "out")
    before = read_contents(tmp_path)
    with pytest.raises(OutputError), keep_checkpoint(tmp_path / "out", "this run", resume=True):
        raise OutputError("disk full")
    assert read_contents(tmp_path) == before


def test_a_place_that_cannot_be_written_is_said_so(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("kept")
    with pytest.raises(OutputError, match="choose another output"):
        Checkpoint(tmp_path / "file" / "out", "this run", resume=False).keep(LOOPS, LoopSearch([], 0))


ANOTHER: dict[str, Callable[[SimulatedRecording], str]] = {
    "settings": lambda s: hash_run(s, Config(sensor=SensorConfig(doppler_beta=0.01)), "psi", s.odometry),
    "front end": lambda s: hash_run(s, Config(), "kiss_icp", s.odometry),
    "no odometry": lambda s: hash_run(s, Config(), "psi", None),
    "other odometry": lambda s: hash_run(s, Config(), "psi", moved(s.odometry)),
    "other recording": lambda s: hash_run(
        simulate_recording(s.scene, s.drive, duration_s=4.0, sensor=s.sensor), Config(), "psi", s.odometry
    ),
}


def moved(track: Trajectory | None) -> Trajectory:
    assert track is not None
    return Trajectory(track.stamps_us, track.poses + np.array([0.0, 0.0, 1e-9]))


@pytest.mark.parametrize("change", ANOTHER)
def test_whatever_changes_the_result_changes_the_key(recording: SimulatedRecording, change: str) -> None:
    key = hash_run(recording, Config(), "psi", recording.odometry)
    assert key == hash_run(recording, Config(), "psi", recording.odometry)
    assert ANOTHER[change](recording) != key
