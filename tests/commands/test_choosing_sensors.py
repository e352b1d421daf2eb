"""The gyroscope, the GNSS fixes and the mount that a run takes: what the recording carries, none, or what is named."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from support.recordings import START_US
from support.sensors import a_gyroscope, some_fixes, stamps, write_gnss_csv, write_imu_csv

from mqslam.commands.batch import read_plan
from mqslam.commands.inputs import choose_fixes, choose_gyroscope, choose_mount
from mqslam.commands.run import open_job
from mqslam.config import Config
from mqslam.core.recording import Recording
from mqslam.core.sensors import Fixes, Inputs, Mount
from mqslam.errors import ConfigError, DataError
from mqslam.formats.recordings import open_recording
from mqslam.formats.sensors.reading import Reading

LATE_US = 10**9


@pytest.fixture
def recording(oxford: Path) -> Recording:
    """A recording with all sensors."""
    return replace(
        open_recording(oxford), gyroscope=a_gyroscope(), fixes=some_fixes(), mount=Mount(np.array([1.0, 0.0, 0.1]), "given")
    )


def test_what_the_recording_carries_is_taken_unless_none_is_wanted(recording: Recording) -> None:
    assert choose_gyroscope(recording, "auto") == Reading(recording.gyroscope)
    assert choose_fixes(recording, "auto") == Reading(recording.fixes)
    assert choose_mount(recording, "auto") is recording.mount
    for choose in (choose_gyroscope, choose_fixes):
        assert choose(recording, "none") == Reading(None)
    assert choose_mount(recording, "none") is None


def test_a_recording_without_sensors_has_none_to_take(oxford: Path) -> None:
    for choose in (choose_gyroscope, choose_fixes):
        assert choose(open_recording(oxford), "auto") == Reading(None)
    assert choose_mount(open_recording(oxford), "auto") is None


def test_named_files_and_numbers_are_taken_instead(recording: Recording, tmp_path: Path) -> None:
    gyroscope = choose_gyroscope(recording, str(write_imu_csv(tmp_path / "mine.csv"))).sensor
    fixes = choose_fixes(recording, str(write_gnss_csv(tmp_path / "gnss.csv"))).sensor
    mount = choose_mount(recording, "-1.5,0.4,90")
    assert gyroscope is not None and gyroscope.source == str(tmp_path / "mine.csv")
    assert fixes is not None and fixes.source == str(tmp_path / "gnss.csv")
    assert mount is not None
    np.testing.assert_allclose(mount.pose, [-1.5, 0.4, np.pi / 2])


def test_what_is_left_out_of_a_named_file_is_told(recording: Recording, tmp_path: Path) -> None:
    rows = [f"{t},0,0,{'x' if k == 3 else 0.1}" for k, t in enumerate(stamps(9).tolist())]
    chosen = choose_gyroscope(recording, str(write_imu_csv(tmp_path / "mine.csv", *rows)))
    assert chosen.sensor is not None and len(chosen.sensor) == 8
    assert any("1 of 9 rows is left out" in fault for fault in chosen.faults)


def test_fixes_that_made_the_truth_are_taken_only_where_their_file_is_named(recording: Recording) -> None:
    chosen = choose_fixes(replace(recording, fixes=some_fixes(made_truth=True)), "auto")
    assert chosen.sensor is None and len(chosen.faults) == 1
    assert "ground truth was made from them; name the file to use them" in chosen.faults[0]


def test_sensors_of_another_time_are_not_used(recording: Recording, tmp_path: Path) -> None:
    late, gone = replace(a_gyroscope(), stamps_us=stamps() + LATE_US), replace(some_fixes(), stamps_us=stamps(5) + LATE_US)
    other = replace(recording, gyroscope=late, fixes=gone)
    for choose in (choose_gyroscope, choose_fixes):
        chosen = choose(other, "auto")
        assert chosen.sensor is None and len(chosen.faults) == 1 and "no time with the radar" in chosen.faults[0]
    file = write_imu_csv(tmp_path / "mine.csv", *(f"{t},0,0,0" for t in (stamps() + LATE_US).tolist()))
    with pytest.raises(DataError, match="shares no time with the recording") as caught:
        choose_gyroscope(recording, str(file))
    assert str(START_US) in caught.value.remedy


@pytest.mark.parametrize(("unit", "us"), [("seconds", 1e6), ("milliseconds", 1e3), ("nanoseconds", 1e-3)])
def test_stamps_in_another_unit_than_microseconds_are_said_to_look_like_it(
    recording: Recording, tmp_path: Path, unit: str, us: float
) -> None:
    times = np.linspace(recording.start_us, recording.end_us, 100) / us
    imu = write_imu_csv(tmp_path / "mine.csv", *(f"{t:.6f},0,0,0" for t in times))
    gnss = write_gnss_csv(tmp_path / "gnss.csv", *(f"{t:.6f},43.0,-79.0,2.5" for t in times))
    for choose, file in ((choose_gyroscope, imu), (choose_fixes, gnss)):
        with pytest.raises(DataError, match=f"recording: its stamps look like {unit}; give them in microseconds, between"):
            choose(recording, str(file))


def test_stamps_since_another_zero_look_like_no_other_unit(recording: Recording, tmp_path: Path) -> None:
    from_zero = replace(recording, stamps_us=recording.stamps_us - recording.start_us)
    for start_us in (3_000_000, 1_000_000_000):
        file = write_imu_csv(tmp_path / "mine.csv", *(f"{t},0,0,0" for t in stamps(40, 10_000, start_us).tolist()))
        with pytest.raises(DataError, match=r"with the recording; give a file with stamps between"):
            choose_gyroscope(from_zero, str(file))


@pytest.mark.parametrize("text", ["1,2", "1,2,left", "1500,0,0", "0,0,nan", "autos"])
def test_extrinsics_that_are_no_pose_are_refused(recording: Recording, text: str) -> None:
    with pytest.raises(ConfigError, match="extrinsics"):
        choose_mount(recording, text)


@pytest.mark.parametrize(
    "inputs",
    [Inputs(imu="none"), Inputs(gnss="none"), Inputs(extrinsics="1,0,0"), Inputs(imu="moved.csv"), Inputs(gnss="moved.csv")],
)
def test_other_sensors_are_another_run(oxford: Path, monkeypatch: pytest.MonkeyPatch, inputs: Inputs) -> None:
    monkeypatch.chdir(oxford.parent)
    write_imu_csv(oxford / "imu.csv")
    write_gnss_csv(oxford / "gnss.csv")
    if inputs.imu == "moved.csv":
        write_imu_csv(Path("moved.csv"), *(f"{t},0.01,-0.02,{0.4 + 1e-9}" for t in stamps().tolist()))
    if inputs.gnss == "moved.csv":
        write_gnss_csv(Path("moved.csv"), *(f"{t},43.7821,-79.4661,2.6" for t in stamps(5).tolist()))
    usual = open_job(oxford, Config())
    assert usual.sensors.gyroscope is not None and usual.sensors.fixes is not None and usual.sensors.mount is None
    assert usual.key == open_job(oxford, Config()).key
    assert open_job(oxford, Config(), inputs=inputs).key != usual.key


def test_what_is_assumed_of_a_named_file_is_a_note_and_what_is_left_out_a_warning(oxford: Path, tmp_path: Path) -> None:
    rows = [f"{t},0,0,{'x' if k == 3 else 23.0}" for k, t in enumerate(stamps(9).tolist())]
    job = open_job(oxford, Config(), inputs=Inputs(imu=str(write_imu_csv(tmp_path / "mine.csv", *rows))))
    assert [note for note in job.recording.notes if "degrees per second" in note]
    assert len(job.warnings) == 1 and "1 of 9 rows is left out" in job.warnings[0]


def test_a_batch_takes_them_beside_its_file(tmp_path: Path) -> None:
    rows = "imu: a/imu.csv, gnss: none, extrinsics: '1.2,0,-90'"
    (tmp_path / "runs.yaml").write_text(f"runs: [{{data: drive, {rows}}}, {{data: drive, name: other}}]")
    first, second = (order.inputs for order in read_plan(tmp_path / "runs.yaml")[0])
    assert (first.imu, first.gnss, first.extrinsics) == (str(tmp_path / "a" / "imu.csv"), "none", "1.2,0,-90")
    assert (second.imu, second.gnss, second.extrinsics, second.odometry) == ("auto",) * 4


@pytest.mark.parametrize(
    ("late_s", "said"),
    [
        (86_400, "late by a day; add -86400 s to them"),
        (-619_315_200, "early by 1024 weeks, after which GPS receivers count from zero again; add 619315200 s to them"),
        (18, "late by 18 s, the difference between GPS time and UTC; add -18 s to them"),
    ],
)
def test_a_clock_that_is_off_by_a_usual_time_is_said(recording: Recording, tmp_path: Path, late_s: int, said: str) -> None:
    late = (np.linspace(recording.start_us, recording.end_us, 9).astype(np.int64) + 1_000_000 * late_s).tolist()
    imu = write_imu_csv(tmp_path / "mine.csv", *(f"{t},0,0,0" for t in late))
    gnss = write_gnss_csv(tmp_path / "gnss.csv", *(f"{t},43.0,-79.0,2.5" for t in late))
    for choose, file in ((choose_gyroscope, imu), (choose_fixes, gnss)):
        with pytest.raises(DataError) as caught:
            choose(recording, str(file))
        assert f"the stamps seem to be {said}; give a file" in str(caught.value)
    own = Fixes(np.array(late), np.full(9, 43.0), np.full(9, -79.0), np.full(9, 2.5), "gps")
    (fault,) = choose_fixes(replace(recording, fixes=own), "auto").faults
    assert fault.endswith(f"are not used: the stamps seem to be {said}")


def test_latitudes_that_no_place_has_are_said_to_be_longitudes(recording: Recording, tmp_path: Path) -> None:
    file = write_gnss_csv(tmp_path / "gnss.csv", f"{recording.start_us},-120.0,43.0,2.5")
    with pytest.raises(DataError, match="its latitudes seem to be longitudes, and the other way round"):
        choose_fixes(recording, str(file))
