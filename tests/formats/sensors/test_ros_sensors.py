"""Sensors in ROS bags as other software writes them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.recordings import KINDS, START_US, TURN_US, Bag, bag_path, bag_writer, oxford_rows
from support.sensors import RATE, stamps

from mqslam.core.recording import Recording
from mqslam.formats.bags import TF_TYPE
from mqslam.formats.recordings import open_recording

IMU, FIX = "sensor_msgs/msg/Imu", "sensor_msgs/msg/NavSatFix"
ABSENT, KNOWN = np.array([-1.0, *[0.0] * 8]), np.zeros(9)
TURNED_OVER = (1.0, 0.0, 0.0, 0.0)  # half a turn about x, as x, y, z, w


def header(bag: Bag, stamp_us: int, frame: str) -> Any:
    made = bag.header(stamp_us)
    made.frame_id = frame
    return made


def imu(bag: Bag, stamp_us: int, rate: Any = RATE, rates_known: Any = KNOWN) -> Any:
    types = bag.store.types
    vector = types["geometry_msgs/msg/Vector3"]
    level = types["geometry_msgs/msg/Quaternion"](0.0, 0.0, 0.0, 1.0)
    turning, still = vector(*(float(value) for value in rate)), vector(0.0, 0.0, 9.8)
    return types[IMU](header(bag, stamp_us, "imu_link"), level, ABSENT, turning, rates_known, still, ABSENT)


def fix(bag: Bag, stamp_us: int, status: int = 0, kind: int = 2, latitude: float = 43.78) -> Any:
    types = bag.store.types
    covariance = np.diag([9.0, 16.0, 49.0]).ravel()
    state = types["sensor_msgs/msg/NavSatStatus"](status, 1)
    return types[FIX](header(bag, stamp_us, "gps"), state, latitude, -79.46, 150.0, covariance, kind)


def static(bag: Bag, parent: str, child: str, move: tuple[float, ...], turn: tuple[float, ...]) -> Any:
    return bag.transform(START_US, (parent, child), move, turn)


def write(path: Path, kind: str, *sensors: tuple[str, str, Any]) -> Recording:
    """Writes three polar scans and messages (topic, type, function of the bag that lists stamps and messages)."""
    with bag_writer(path, kind) as bag:
        radar = bag.topic("/Navtech/Polar", "sensor_msgs/msg/Image")
        messages = [(START_US + k * TURN_US, radar, bag.image(START_US + k * TURN_US, oxford_rows(k))) for k in range(3)]
        for topic, message_type, listed in sensors:
            connection = bag.topic(topic, message_type)
            messages += [(stamp, connection, message) for stamp, message in listed(bag)]
        for stamp, connection, message in sorted(messages, key=lambda entry: entry[0]):
            bag.write(connection, stamp, message)
    return open_recording(path)


def imus(**changed: Any) -> Any:
    return lambda bag: [(t, imu(bag, t, **changed)) for t in stamps().tolist()]


def fixes(**changed: Any) -> Any:
    return lambda bag: [(t, fix(bag, t, **changed)) for t in stamps(5, 100_000).tolist()]


@pytest.mark.parametrize("kind", KINDS)
def test_gyroscope_fixes_and_mount_are_read_from_every_kind_of_bag(tmp_path: Path, kind: str) -> None:
    half = np.sin(np.pi / 4)
    recording = write(
        bag_path(tmp_path, kind),
        kind,
        ("/imu/data", IMU, imus()),
        ("/fix", FIX, fixes()),
        (
            "/tf_static",
            TF_TYPE,
            lambda bag: [(START_US, static(bag, "base_link", "mast", (1.0, 0.0, 1.5), (0, 0, half, half)))],
        ),
    )
    assert recording.gyroscope is not None and recording.fixes is not None
    np.testing.assert_array_equal(recording.gyroscope.stamps_us, stamps())
    np.testing.assert_allclose(recording.gyroscope.rates, np.tile(RATE, (40, 1)))
    assert recording.gyroscope.source == "/imu/data" and recording.fixes.source == "/fix"
    assert recording.fixes.latitudes.tolist() == [43.78] * 5 and recording.fixes.longitudes.tolist() == [-79.46] * 5
    np.testing.assert_allclose(recording.fixes.sigmas_m, np.sqrt((9.0 + 16.0) / 2.0))
    assert not recording.fixes.made_truth and recording.mount is None and not recording.faults


def test_the_radars_mount_is_the_chain_of_static_transforms(tmp_path: Path) -> None:
    half = np.sin(np.pi / 4)
    mount = write(
        tmp_path / "drive.mcap",
        "mcap",
        (
            "/tf_static",
            TF_TYPE,
            lambda bag: [
                (START_US, static(bag, "base_link", "mast", (1.0, 0.2, 1.5), (0.0, 0.0, half, half))),
                (START_US, static(bag, "mast", "radar", (0.5, 0.0, 0.1), (0.0, 0.0, 0.0, 1.0))),
            ],
        ),
    ).mount
    assert mount is not None and mount.source == "/tf_static"
    np.testing.assert_allclose(mount.pose, [1.0, 0.7, np.pi / 2], rtol=0.0, atol=1e-12)


def test_a_gyroscope_that_is_mounted_upside_down_is_turned(tmp_path: Path) -> None:
    over = (
        "/tf_static",
        TF_TYPE,
        lambda bag: [(START_US, static(bag, "base_link", "imu_link", (0.0, 0.0, 0.0), TURNED_OVER))],
    )
    recording = write(tmp_path / "drive.mcap", "mcap", ("/imu", IMU, imus(rate=RATE * [1, -1, -1])), over)
    assert recording.gyroscope is not None and any("rotated to the vehicle's axes" in note for note in recording.notes)
    np.testing.assert_allclose(recording.gyroscope.rates, np.tile(RATE, (40, 1)), rtol=0.0, atol=1e-12)


def test_a_receiver_without_a_fix_gives_none(tmp_path: Path) -> None:
    recording = write(tmp_path / "drive.mcap", "mcap", ("/fix", FIX, fixes(status=-1)))
    assert recording.fixes is None and not recording.faults
    assert "the receiver states no fix in 5 messages on /fix: left out" in recording.notes


def test_a_covariance_of_unknown_type_is_no_deviation(tmp_path: Path) -> None:
    recording = write(tmp_path / "drive.mcap", "mcap", ("/fix", FIX, fixes(kind=0)))
    assert recording.fixes is not None and np.isnan(recording.fixes.sigmas_m).all()


def test_an_imu_that_states_no_rates_is_no_gyroscope(tmp_path: Path) -> None:
    recording = write(tmp_path / "drive.mcap", "mcap", ("/imu", IMU, imus(rates_known=ABSENT)))
    assert recording.gyroscope is None
    assert any("of which none has a stamp and finite rates" in fault for fault in recording.faults)


def test_rates_that_are_not_finite_are_left_out_and_counted(tmp_path: Path) -> None:
    def listed(bag: Bag) -> list[tuple[int, Any]]:
        return [(t, imu(bag, t, [0.0, np.nan if k == 3 else 0.1, 0.0])) for k, t in enumerate(stamps(10).tolist())]

    recording = write(tmp_path / "drive.mcap", "mcap", ("/imu", IMU, listed))
    assert recording.gyroscope is not None and len(recording.gyroscope) == 9
    assert recording.faults == ("/imu: 1 of 10 rows is left out: damaged, or with numbers that are not finite",)


def test_of_several_topics_the_one_with_most_messages_is_read_and_truth_last(tmp_path: Path) -> None:
    recording = write(
        tmp_path / "drive.mcap",
        "mcap",
        ("/a/imu", IMU, lambda bag: [(t, imu(bag, t)) for t in stamps(10).tolist()]),
        ("/b/imu", IMU, imus()),
        ("/ground_truth/fix", FIX, fixes()),
        ("/fix", FIX, lambda bag: [(START_US, fix(bag, START_US))]),
    )
    assert recording.gyroscope is not None and recording.gyroscope.source == "/b/imu"
    assert recording.fixes is not None and recording.fixes.source == "/fix" and not recording.fixes.made_truth
    assert "other sensors of these kinds are not read: /a/imu, /ground_truth/fix" in recording.notes
    truth = write(tmp_path / "truth.mcap", "mcap", ("/ground_truth/fix", FIX, fixes())).fixes
    assert truth is not None and truth.made_truth


def test_damaged_transforms_cost_the_mount_only(tmp_path: Path) -> None:
    broken = (
        "/tf_static",
        TF_TYPE,
        lambda bag: [(START_US, static(bag, "base_link", "radar", (0.0, 0.0, 0.0), (0, 0, 0, 0)))],
    )
    recording = write(tmp_path / "drive.mcap", "mcap", broken)
    assert recording.mount is None and len(recording) == 3
    assert recording.faults == (f"{tmp_path / 'drive.mcap'} holds 1 damaged message on /tf_static: left out",)
    endless = (
        "/tf_static",
        TF_TYPE,
        lambda bag: [(START_US, static(bag, "base_link", "radar", (np.inf, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0)))],
    )
    recording = write(tmp_path / "endless.mcap", "mcap", endless)
    assert recording.mount is None and len(recording.faults) == 1


def test_fixes_whose_status_is_not_set_are_taken_if_they_have_a_place(tmp_path: Path) -> None:
    recording = write(tmp_path / "a.mcap", "mcap", ("/fix", FIX, fixes(status=-2)))
    assert recording.fixes is not None and len(recording.fixes.stamps_us) == 5
    assert "5 messages on /fix whose status is not set (-2): those with a position are taken as fixes" in recording.notes
    assert not any("states no fix" in note for note in recording.notes)
    nowhere = write(tmp_path / "b.mcap", "mcap", ("/fix", FIX, fixes(status=-2, latitude=float("nan"))))
    assert nowhere.fixes is None and not nowhere.faults
