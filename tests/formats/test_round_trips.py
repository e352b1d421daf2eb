"""A recording comes back from every layout, and from every layout through every other, as far as they keep it."""

from __future__ import annotations

import itertools
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from support.conversions import BAGS, EVEN, STAMPED, changed, convert, converted, uneven_oxford
from support.layouts import assert_alike, left_turn
from support.parameters import mostly_slow
from support.recordings import assert_same

from mqslam.core import se2
from mqslam.core.recording import Recording
from mqslam.core.trajectory import Trajectory
from mqslam.formats.recordings import open_recording

WITHOUT_VALIDITY = ("b_scan", *EVEN)
NEXT = list(itertools.pairwise((*STAMPED, STAMPED[0])))  # every layout once as the first and once as the second
WITH_START_STAMPS = ("oxford", *BAGS, "b_scan", "native")


@pytest.fixture(scope="module")
def uneven(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    return open_recording(uneven_oxford(tmp_path_factory.mktemp("uneven") / "drive"), range_resolution=0.5)


@pytest.mark.parametrize(("first", "second"), mostly_slow(itertools.product(STAMPED, STAMPED), NEXT))
def test_power_times_and_angles_survive_every_pair_of_layouts_that_stamp_azimuths(
    uneven: Recording, tmp_path: Path, first: str, second: str
) -> None:
    there = converted(uneven, tmp_path / "a", first)
    back = converted(converted(there, tmp_path / "b", second), tmp_path / "c", "oxford")
    for one, other in zip(uneven.polar_scans(), back.polar_scans(), strict=True):
        np.testing.assert_array_equal(one.power, other.power)
        np.testing.assert_array_equal(one.azimuths, other.azimuths)
        np.testing.assert_allclose(one.times, other.times, rtol=0.0, atol=1e-9)
        if not {first, second} & set(WITHOUT_VALIDITY):
            np.testing.assert_array_equal(one.valid, other.valid)
    assert back.start_us == uneven.start_us and back.end_us == uneven.end_us


@pytest.mark.parametrize("layout", WITH_START_STAMPS)
def test_layouts_stamped_at_the_start_give_the_same_stream(uneven: Recording, tmp_path: Path, layout: str) -> None:
    back = converted(uneven, tmp_path, layout)
    if layout == "b_scan":
        np.testing.assert_array_equal(back.stamps_us, uneven.stamps_us)
    else:
        assert_same(uneven, back)


@pytest.mark.parametrize("layout", ["boreas", "mulran_oxford"])
def test_layouts_named_after_the_middle_or_the_end_give_the_starts_nearly(
    uneven: Recording, tmp_path: Path, layout: str
) -> None:
    back = converted(uneven, tmp_path, layout)
    np.testing.assert_allclose(back.stamps_us - uneven.stamps_us, 0, atol=40_000)
    assert_alike(left_turn(), converted(left_turn(), tmp_path / "even", layout))


@pytest.mark.parametrize(
    ("first", "second"),
    mostly_slow(
        [*itertools.product(EVEN, STAMPED), *itertools.product(STAMPED, EVEN)],
        [*itertools.product(EVEN, ("oxford", "rosbag1")), *itertools.product(("boreas", "native"), EVEN)],
    ),
)
def test_even_polar_scans_survive_layouts_that_stamp_only_them(tmp_path: Path, first: str, second: str) -> None:
    there = converted(left_turn(), tmp_path / "a", first)
    assert_alike(left_turn(), there)
    assert_alike(left_turn(), converted(converted(there, tmp_path / "b", second), tmp_path / "c", "oxford"))


@pytest.mark.parametrize("layout", [*STAMPED, *EVEN])
def test_odometry_and_ground_truth_go_along_where_there_is_a_place(uneven: Recording, tmp_path: Path, layout: str) -> None:
    drive = left_turn() if layout in EVEN else uneven
    out, notes = convert(drive, tmp_path, layout)
    back = open_recording(out)
    if layout in ("oxford", "native", "b_scan", *BAGS):
        assert_same_motion(back.odometry, drive.odometry)
        assert not [note for note in notes if "left behind" in note]
    else:
        assert back.odometry is None and "odometry is left behind: mqslam does not write it in this layout" in notes
    if layout == "radiate":
        assert back.ground_truth is None and "ground truth is left behind: mqslam does not write it in this layout" in notes
    elif layout == "boreas":
        assert back.ground_truth is not None and drive.ground_truth is not None
        stamps = back.ground_truth.stamps_us
        assert len(stamps) == len(drive)
        assert_same_motion(back.ground_truth, Trajectory(stamps, drive.ground_truth.at(stamps)))
    else:
        assert_same_motion(back.ground_truth, drive.ground_truth)


@pytest.mark.parametrize("layout", [*STAMPED, *EVEN])
def test_the_length_of_a_bin_is_kept_or_asked_for(tmp_path: Path, layout: str) -> None:
    out, notes = convert(left_turn(), tmp_path, layout)
    asked = [note for note in notes if note.endswith("read the result with sensor.range_resolution_m: 0.5")]
    if layout in ("oxford", "native"):
        assert open_recording(out).range_resolution == 0.5 and not asked
    else:
        assert open_recording(out).range_resolution != 0.5 and len(asked) == 1


@pytest.mark.parametrize("layout", [*STAMPED, *EVEN])
def test_marks_of_azimuths_that_were_not_measured_are_kept_or_missed(oxford: Path, tmp_path: Path, layout: str) -> None:
    recording = open_recording(oxford)
    image = next((oxford / "radar").glob("*.png"))
    pixels = np.array(Image.open(image))
    pixels[[4, 7], 10] = 0
    Image.fromarray(pixels).save(image)
    out, notes = convert(recording, tmp_path, layout)
    missed = sum(int(np.count_nonzero(~polar_scan.valid)) for polar_scan in open_recording(out).polar_scans())
    told = [note for note in notes if note.startswith("2 azimuths marked as not measured: the layout")]
    assert (missed, len(told)) == ((0, 1) if layout in WITHOUT_VALIDITY else (2, 0))


def assert_same_motion(a: Trajectory | None, b: Trajectory | None) -> None:
    """Checks that two trajectories agree but for their fixed frame, to the micrometres that files keep."""
    assert a is not None and b is not None
    np.testing.assert_array_equal(a.stamps_us, b.stamps_us)
    moved = [se2.between(track.poses[:1], track.poses) for track in (a, b)]
    np.testing.assert_allclose(moved[0][:, :2], moved[1][:, :2], rtol=0.0, atol=3e-6)
    np.testing.assert_allclose(se2.wrap(moved[0][:, 2] - moved[1][:, 2]), 0.0, rtol=0.0, atol=1e-8)


@pytest.mark.parametrize("layout", EVEN)
def test_turns_that_begin_one_step_late_fill_the_first_column_from_the_turn_before(tmp_path: Path, layout: str) -> None:
    step = 2.0 * np.pi / left_turn().sensor.azimuths
    late = changed(azimuths=lambda r: r.azimuths - step)
    back = converted(late, tmp_path, layout)
    before = np.zeros_like(late[0].power[-1])
    for one, other in zip(late.polar_scans(), back.polar_scans(), strict=True):
        np.testing.assert_array_equal(other.power, np.vstack([before, one.power[:-1]]))
        np.testing.assert_allclose(other.azimuths[1:], one.azimuths[:-1], rtol=0.0, atol=1e-9)
        before = one.power[-1]
