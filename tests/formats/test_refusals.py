"""What a layout cannot hold is refused by name, or written with a note; nothing half-written stays behind."""

from __future__ import annotations

import sqlite3
import weakref
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from support.conversions import BAGS, EVEN, STAMPED, Turns, changed, convert, converted, spinning
from support.layouts import assert_alike_polar_scan, left_turn

from mqslam.core.recording import PolarScan
from mqslam.core.trajectory import Trajectory
from mqslam.errors import DataError, OutputError
from mqslam.formats import bags
from mqslam.formats.recordings import open_recording


def counter_clockwise() -> Turns:
    return changed(azimuths=lambda r: -r.azimuths)


@pytest.mark.parametrize("layout", [layout for layout in STAMPED if layout != "native"])
def test_encoder_values_cannot_hold_a_counter_clockwise_turn(tmp_path: Path, layout: str) -> None:
    with pytest.raises(DataError, match="drive: polar scan 0 turns counter-clockwise"):
        convert(counter_clockwise(), tmp_path, layout)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("layout", EVEN)
def test_polar_images_hold_it_where_the_reader_is_told(tmp_path: Path, layout: str) -> None:
    out, notes = convert(counter_clockwise(), tmp_path, layout)
    assert any("sensor: {clockwise: false}" in note for note in notes)
    for one, other in zip(counter_clockwise().turns, open_recording(out, clockwise=False).polar_scans(), strict=True):
        assert_alike_polar_scan(one, other)


def test_the_native_layout_holds_it_as_it_is(tmp_path: Path) -> None:
    back = converted(counter_clockwise(), tmp_path, "native")
    np.testing.assert_array_equal(back[3].azimuths, counter_clockwise()[3].azimuths)


@pytest.mark.parametrize("layout", EVEN)
@pytest.mark.parametrize(
    ("recording", "problem"),
    [
        (changed(azimuths=lambda r: r.azimuths - 0.3), "azimuths of polar scan 0 lie 8.19 deg off the even steps"),
        (changed(azimuths=lambda r: r.azimuths * 0.9), "azimuths of polar scan 0 lie 35.10 deg off the even steps"),
        (changed(power=lambda r: r.power[:, :30]), r"has more azimuths \(40\) than range bins \(30\)"),
        (
            changed(power=lambda r: r.power[:, : 190 if r.times[0] > 0.6 else 200]),
            "polar scan 3 has 40 azimuths by 190 bins, the first 40 azimuths by 200 bins",
        ),
    ],
)
def test_polar_images_refuse_what_they_would_bend(tmp_path: Path, layout: str, recording: Turns, problem: str) -> None:
    with pytest.raises(DataError, match=f"drive: {problem}"):
        convert(recording, tmp_path, layout)
    assert list(tmp_path.iterdir()) == []


def test_a_small_offset_of_polar_images_is_told(tmp_path: Path) -> None:
    _, notes = convert(changed(azimuths=lambda r: r.azimuths - 0.01), tmp_path, "radiate")
    assert any("azimuths lie up to 0.57 deg off the even steps" in note for note in notes)


@pytest.mark.parametrize("layout", [*EVEN, *(layout for layout in STAMPED if layout != "native")])
def test_images_cannot_hold_a_polar_scan_of_one_azimuth(tmp_path: Path, layout: str) -> None:
    with pytest.raises(DataError, match=r"drive: polar scan 0 has one azimuth, and this layout needs two"):
        convert(spinning([0, 250_000], 250_000, azimuths=1), tmp_path, layout)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("layout", [*STAMPED, *EVEN])
def test_a_single_pose_is_no_trajectory_and_left_behind(tmp_path: Path, layout: str) -> None:
    recording = spinning([0], 250_000)
    pose = Trajectory(recording.stamps_us, np.zeros((1, 3)))
    out, notes = convert(replace(recording, ground_truth=pose, odometry=pose), tmp_path, layout)
    assert "ground truth is left behind: one pose is no trajectory" in notes
    back = open_recording(out)
    assert len(back) == 1 and back.ground_truth is None and back.odometry is None and back.faults == ()


@pytest.mark.parametrize("layout", BAGS)
def test_a_bag_of_rows_begins_with_half_a_turn_at_least(tmp_path: Path, layout: str) -> None:
    with pytest.raises(DataError, match="drive: the first polar scan covers less than half a turn"):
        convert(changed(azimuths=lambda r: r.azimuths * 0.4), tmp_path, layout)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("layout", ["mulran", "mulran_oxford"])
def test_stamps_that_no_nanoseconds_can_be_are_refused(tmp_path: Path, layout: str) -> None:
    with pytest.raises(DataError, match="drive: begins at 5000000 us"):
        convert(changed(start_us=5_000_000), tmp_path, layout)


@pytest.mark.parametrize("layout", ["oxford", "boreas", "radiate", "native", *BAGS])
def test_stamps_that_count_from_the_start_of_a_recording_are_kept(tmp_path: Path, layout: str) -> None:
    back = converted(changed(start_us=5_000_000), tmp_path, layout)
    np.testing.assert_allclose(back.stamps_us, 5_000_000 + 250_000 * np.arange(6), rtol=0.0, atol=1)


@pytest.mark.parametrize("layout", BAGS)
def test_stamps_outside_the_clock_of_ros_are_refused(tmp_path: Path, layout: str) -> None:
    with pytest.raises(OutputError, match=rf"^{tmp_path}/{layout}(\.bag|\.mcap)?: stamp .* is outside ROS's clock"):
        convert(changed(start_us=2**31 * 1_000_000), tmp_path, layout)
    assert list(tmp_path.iterdir()) == []


def test_a_finer_encoder_is_kept_by_the_drivers_messages(tmp_path: Path) -> None:
    ticks = 3 + 401 * np.arange(40)
    fine = changed(azimuths=lambda r: -2.0 * np.pi * ticks / 16000)
    np.testing.assert_array_equal(converted(fine, tmp_path, "b_scan")[2].azimuths, fine.turns[2].azimuths)


def test_sqlite_is_not_given_a_path_it_would_misread(tmp_path: Path) -> None:
    with pytest.raises(OutputError, match="sqlite gives"):
        convert(left_turn(), tmp_path / "50%", "rosbag2")
    assert not list((tmp_path / "50%").iterdir())


@pytest.mark.parametrize("layout", [*STAMPED, *EVEN])
def test_a_recording_that_breaks_off_leaves_nothing(tmp_path: Path, layout: str) -> None:
    class Broken(Turns):
        def polar_scans(self, start: int = 0, stop: int | None = None) -> Iterator[PolarScan]:
            yield from self.turns[start:4]
            raise DataError("4.png", "is not a readable PNG")

    recording = changed()
    broken = Broken(**{name: getattr(recording, name) for name in recording.__dataclass_fields__})
    with pytest.raises(DataError, match=r"4\.png"):
        convert(broken, tmp_path, layout)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("layout", ["rosbag1", "rosbag2"])
@pytest.mark.parametrize("error", [OSError(28, "No space left on device"), sqlite3.OperationalError("disk is full")])
def test_a_full_disk_is_an_error_of_the_output(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, layout: str, error: Exception
) -> None:
    def full(*_: object) -> None:
        raise error

    monkeypatch.setattr(bags.Bag, "write", full)
    with pytest.raises(OutputError, match=rf"{layout}.*: cannot be written \((No space left on device|disk is full)\)"):
        convert(left_turn(), tmp_path, layout)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("layout", [*STAMPED, *EVEN])
def test_one_polar_scan_is_held_at_a_time(tmp_path: Path, layout: str) -> None:
    alive: list[int] = []
    most = 0

    class Counted(np.ndarray):
        def __array_finalize__(self, _: object) -> None: ...

    class Watched(Turns):
        def polar_scans(self, start: int = 0, stop: int | None = None) -> Iterator[PolarScan]:
            nonlocal most
            for k, turn in enumerate(self.turns[start:stop]):
                power = turn.power.copy().view(Counted)
                alive.append(k)
                weakref.finalize(power, alive.remove, k)
                most = max(most, len(alive))
                yield replace(turn, power=power)
                del power

    recording = changed()
    convert(Watched(**{name: getattr(recording, name) for name in recording.__dataclass_fields__}), tmp_path, layout)
    assert most <= 2  # the one that is written, while the next one is read
