"""A recording comes back from every layout, and from every layout through every other, as far as they keep it."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from support.conversions import BAGS, EVEN, STAMPED, changed, convert, converted, uneven_oxford
from support.layouts import assert_alike, left_turn, write_boreas, write_mulran_columns, write_mulran_rows, write_radiate
from support.parameters import mostly_slow
from support.recordings import START_US, assert_same
from support.sensors import a_gyroscope, some_fixes

from mqslam.core import se2
from mqslam.core.recording import Recording
from mqslam.core.sensors import Mount
from mqslam.core.trajectory import Trajectory
from mqslam.formats.recordings import open_recording
from mqslam.simulator import SimulatedRecording

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
    told = [note for note in notes if note.startswith("the layout cannot mark 2 azimuths as not measured")]
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


def images(root: Path) -> dict[str, np.ndarray]:
    """Returns the pixels of every image below a folder by its path."""
    return {str(path.relative_to(root)): np.array(Image.open(path)) for path in sorted(root.rglob("*.png"))}


def to_whole_us(name: str) -> str:
    """Returns a path whose file is named after a stamp in ns, cut to whole microseconds."""
    folder, _, stem = name.removesuffix(".png").rpartition("/")
    return f"{folder}/{int(stem) // 1000}"


@pytest.mark.parametrize(
    ("layout", "describe", "in_ns"),
    [
        ("boreas", write_boreas, False),  # named after the middles of the turns
        ("radiate", write_radiate, False),  # numbered
        ("mulran", write_mulran_columns, True),  # named after the ends
        ("mulran_oxford", write_mulran_rows, True),
    ],
)
def test_images_are_those_that_the_description_of_the_layout_makes(
    tmp_path: Path, layout: str, describe: Callable[[Path, SimulatedRecording], Path], in_ns: bool
) -> None:
    described, written = describe(tmp_path / "described", left_turn()), convert(left_turn(), tmp_path, layout)[0]
    ours, theirs = images(written), images(described)
    name_of = to_whole_us if in_ns else str
    assert [name_of(name) for name in ours] == [name_of(name) for name in theirs]
    for one, other in zip(ours.values(), theirs.values(), strict=True):
        stamped = 8 if layout == "mulran_oxford" else 0  # rows begin with a stamp in ns, written to whole us
        np.testing.assert_array_equal(one[:, stamped:], other[:, stamped:])
        stamps = [np.ascontiguousarray(rows[:, :stamped]).view("<i8") // 1000 for rows in (one, other) if stamped]
        assert not stamps or np.array_equal(*stamps)


def test_boreas_and_radiate_state_poses_and_arrivals_as_described(tmp_path: Path) -> None:
    described, written = write_boreas(tmp_path / "described", left_turn()), convert(left_turn(), tmp_path, "boreas")[0]
    columns = [(root / "applanix" / "radar_poses.csv").read_text().splitlines()[0] for root in (described, written)]
    assert columns[0] == columns[1]
    poses = np.loadtxt(written / "applanix" / "radar_poses.csv", delimiter=",", skiprows=1)
    middle = poses[len(poses) // 2]
    assert np.hypot(middle[4], middle[5]) == pytest.approx(8.0, rel=0.01) and middle[10] == pytest.approx(-0.4, rel=0.01)
    described, written = write_radiate(tmp_path / "city", left_turn()), convert(left_turn(), tmp_path, "radiate")[0]
    lists = [(root / "Navtech_Polar.txt").read_text().splitlines() for root in (described, written)]
    assert [line[:-3] for line in lists[0]] == [line[:-3] for line in lists[1]]


CARRYING = ("oxford", "native", *BAGS, "b_scan")
LOSING = ("boreas", "mulran_oxford", *EVEN)
POSE = np.array([1.25, -0.5, 0.3])


def equipped(oxford: Path, *, made_truth: bool = False) -> Recording:
    """Returns a recording with all sensors."""
    recording = open_recording(oxford, range_resolution=0.5)
    fixes, mount = some_fixes(made_truth=made_truth), Mount(POSE, "given")
    return replace(recording, gyroscope=a_gyroscope(), fixes=fixes, mount=mount)


@pytest.mark.parametrize("made_truth", [False, True])
@pytest.mark.parametrize("layout", CARRYING)
def test_sensors_go_along(oxford: Path, tmp_path: Path, layout: str, made_truth: bool) -> None:
    out, notes = convert(equipped(oxford, made_truth=made_truth), tmp_path, layout)
    back = open_recording(out)
    assert back.gyroscope is not None and back.fixes is not None and back.mount is not None
    assert not back.faults and not [note for note in notes if "left behind" in note]
    np.testing.assert_array_equal(back.gyroscope.stamps_us, a_gyroscope().stamps_us)
    np.testing.assert_allclose(back.gyroscope.rates, a_gyroscope().rates, rtol=1e-11)
    np.testing.assert_array_equal(back.fixes.stamps_us, some_fixes().stamps_us)
    np.testing.assert_allclose(back.fixes.latitudes, some_fixes().latitudes, rtol=0.0, atol=1e-10)
    np.testing.assert_allclose(back.fixes.longitudes, some_fixes().longitudes, rtol=0.0, atol=1e-10)
    np.testing.assert_allclose(back.fixes.sigmas_m, some_fixes().sigmas_m, rtol=1e-11)
    assert back.fixes.made_truth is made_truth
    np.testing.assert_allclose(back.mount.pose, POSE, rtol=0.0, atol=1e-12)


@pytest.mark.parametrize("layout", LOSING)
def test_what_mqslam_does_not_write_in_a_layout_is_noted(oxford: Path, tmp_path: Path, layout: str) -> None:
    notes = convert(equipped(oxford), tmp_path, layout)[1]
    for what in ("the gyroscope", "GNSS", "the radar's mount"):
        assert f"{what} is left behind: mqslam does not write it in this layout" in notes


@pytest.mark.parametrize("layout", ["oxford", "native", "mcap"])
def test_a_recording_without_sensors_gets_none(oxford: Path, tmp_path: Path, layout: str) -> None:
    back = open_recording(convert(open_recording(oxford), tmp_path, layout)[0])
    assert back.gyroscope is None and back.fixes is None and back.mount is None


def test_an_array_of_another_shape_costs_its_sensor_only(oxford: Path, tmp_path: Path) -> None:
    out, _ = convert(equipped(oxford), tmp_path, "native")
    with np.load(out) as archive:
        arrays = {name: archive[name] for name in archive.files}
    np.savez(out, **{**arrays, "gyroscope_rates": arrays["gyroscope_rates"][:, :2], "mount_pose": np.full(3, np.nan)})
    back = open_recording(out)
    assert back.gyroscope is None and back.mount is None and back.fixes is not None and back.start_us == START_US
    assert len(back.faults) == 2 and "gyroscope_rates is float64 of shape (40, 2)" in back.faults[0]
