"""Files made to do harm: they exhaust memory, reach out of the recording, or carry code."""

from __future__ import annotations

import gzip
import os
import pickle
import shutil
import struct
import zipfile
import zlib
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from support.commands import mqslam
from support.faults import assert_refused, images, interrupt, run_quickly
from support.layouts import left_turn, write_radiate
from support.limits import within_limits
from support.recordings import bag_path, write_bag, write_oxford
from support.subjects import SUBJECTS

from mqslam.execution.folders import CHECKPOINT
from mqslam.formats.recordings import FORMATS, open_recording


def test_a_file_that_would_unpack_to_gigabytes(drive: Path, tmp_path: Path) -> None:
    def refuse(said: str, *words: str | Path) -> None:
        with within_limits(0, always_mb=150.0, seconds=300.0):
            shown = mqslam(*words, "--quiet") if words else run_quickly(drive, tmp_path / "out", "--strict", "--quiet")
            assert_refused(shown, said)

    bomb = images(drive)[7]
    for content in (
        big_png(9000, 9000),
        big_png(60_000, 60).replace(struct.pack(">II", 60_000, 60), struct.pack(">II", 60_000, 60_000)),
    ):
        bomb.write_bytes(content)
        refuse(str(bomb))
    archive = tmp_path / "bomb.npz"
    with zipfile.ZipFile(archive, "w", zipfile.ZIP_DEFLATED) as file, file.open("stamps_us.npy", "w") as member:
        np.lib.format.write_array_header_1_0(member, {"descr": "<i8", "fortran_order": False, "shape": (25 * 10**6,)})
        for _ in range(200):
            member.write(bytes(10**6))
    for command in ("run", "audit"):
        refuse("bomb.npz: would unpack to 200 MB", command, archive, "--out", tmp_path / "out")
    log = tmp_path / "bomb.log.gz"
    with gzip.open(log, "wb", 9) as file:
        for _ in range(50):
            file.write(b"ODOM 0 0 0 0 0 0 1.0 host 1.0\n" * 33_000)
    refuse("bomb.log.gz: unpacks to more than", "audit", log, "--out", tmp_path / "out")


def big_png(width: int, height: int) -> bytes:
    """Returns an image of zeros, which packs a thousandfold."""

    def chunk(kind: bytes, content: bytes) -> bytes:
        return struct.pack(">I", len(content)) + kind + content + struct.pack(">I", zlib.crc32(kind + content))

    packer = zlib.compressobj(9)
    row = bytes(width + 1)
    body = b"".join(packer.compress(row) for _ in range(height)) + packer.flush()
    head = struct.pack(">IIBBBBB", width, height, 8, 0, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + chunk(b"IDAT", body) + chunk(b"IEND", b"")


def test_a_name_that_leaves_the_recording(drive: Path, tmp_path: Path) -> None:
    secret = tmp_path / "secret"
    secret.mkdir()
    image = images(drive)[7]
    shutil.move(image, secret / image.name)
    listing = drive / "radar.timestamps"
    listed = listing.read_text()
    listing.write_text(listed + f"../../secret/{image.stem} 1\n")
    assert_refused(run_quickly(drive, tmp_path / "out"), "radar.timestamps: has lines other than '<t> 1'")
    listing.write_text(listed)
    image.symlink_to(secret / image.name)
    assert_refused(run_quickly(drive, tmp_path / "out"), f"{image}: is a link out of the recording")
    city = write_radiate(tmp_path / "city", left_turn())
    text = (city / "Navtech_Polar.txt").read_text()
    (city / "Navtech_Polar.txt").write_text(text.replace("Frame: 000003", "Frame: ../../3"))
    assert_refused(run_quickly(city, tmp_path / "out"), "line 3 is not 'Frame: 000001 Time: ")
    (city / "Navtech_Polar.txt").write_text(text)
    (city / "Navtech_Polar" / "000003.png").rename(secret / "000003.png")
    (city / "Navtech_Polar" / "000003.png").symlink_to(secret / "000003.png")
    assert_refused(run_quickly(city, tmp_path / "out"), "000003.png: is a link out of the recording")
    bag = write_bag(open_recording(write_oxford(tmp_path / "few")), bag_path(tmp_path, "ros2"), "ros2")
    file = next(bag.glob("*.db3"))
    file.rename(secret / file.name)
    metadata = bag / "metadata.yaml"
    metadata.write_text(metadata.read_text().replace(file.name, f"../secret/{file.name}"))
    assert_refused(run_quickly(bag, tmp_path / "out"), f"{bag}: is not a readable bag")
    assert not (tmp_path / "out").exists()


def test_a_link_a_pipe_or_a_device_in_place_of_a_file(drive: Path, tmp_path: Path) -> None:
    """Every kind of both is in `tests/execution/test_untrusted.py`."""
    secret = tmp_path / "secret"
    secret.write_text("t,v,omega\n0,1,0\n")
    for name in ("radar.timestamps", "recording.json", "odom.csv", "imu.csv", "gnss.csv", "gt/poses_tum.txt"):
        for place in (lambda file: file.symlink_to(secret), os.mkfifo, lambda file: file.symlink_to("/dev/zero")):
            copy = shutil.copytree(drive, tmp_path / "copy")
            (copy / name).unlink(missing_ok=True)
            place(copy / name)
            shown = mqslam("info", copy)
            assert f"{copy / name}" in shown.out + shown.err, name
            assert "is a link out of the recording" in shown.out + shown.err or "is a pipe" in shown.out + shown.err
            shutil.rmtree(copy)
    os.mkfifo(tmp_path / "pipe")
    for named in (tmp_path / "pipe", "/dev/zero"):
        for option in ("--odometry", "--imu", "--gnss", "--config"):
            shown = mqslam("run", drive, "--out", tmp_path / "out", option, named, "--quiet")
            assert_refused(shown, str(named))
        assert_refused(mqslam("audit", drive, "--trajectory", named, "--out", tmp_path / "out", "--quiet"), str(named))
        assert_refused(mqslam("batch", named, "--out", tmp_path / "out"), str(named))
        assert_refused(mqslam("info", named), str(named))
    assert not (tmp_path / "out").exists()


def test_a_line_without_an_end(drive: Path, tmp_path: Path) -> None:
    (drive / "odom.csv").write_bytes(b"t,v,omega" + b"9" * 3_000_000)
    shown = mqslam("info", drive)
    assert shown.code == 0 and "odom.csv has a line of over 1000000 bytes: left out" in shown.out
    assert_refused(run_quickly(drive, tmp_path / "out", "--strict"), "odom.csv has a line of over 1000000 bytes")


def test_a_name_that_commands_the_terminal(drive: Path, tmp_path: Path) -> None:
    """Every kind of character and of place is in `tests/execution/test_shown.py`."""
    hostile = "drive\x1b]0;PWNED\x07\x9b31m\u202e[red]gnp"
    named = drive.rename(tmp_path / hostile)
    images(named)[7].write_bytes(b"broken")
    shown = run_quickly(named, tmp_path / "out", "-v")
    assert shown.code == 0 and "drive\\x1b]0;PWNED\\x07\\x9b31m\\u202e[red]gnp" in shown.err
    texts = [shown.out, shown.err, *(file.read_text() for file in (tmp_path / "out").glob("*.[hljcy]*") if file.is_file())]
    assert len(texts) > 7 and not any(set(text) & set("\x1b\x07\x9b\u202e") for text in texts)


def test_a_file_on_which_a_library_crashes(tmp_path: Path) -> None:
    """LAZ files and GTSAM's archives are read in a process of its own: `tests/execution/test_apart.py`."""
    crash = Path(__file__).parents[1] / "support" / "files" / "crash.laz"
    shown = mqslam("audit", crash, "--out", tmp_path / "out", "--quiet")
    assert_refused(shown, "crash.laz: is not a readable .laz (the library that reads it crashed)")


def test_an_error_that_a_reader_lets_through(drive: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Every kind of error is in `tests/execution/test_untrusted.py`."""

    def fail(*_: object) -> None:
        raise OverflowError("Python int too large to convert to C long")

    with monkeypatch.context() as patch:
        patch.setattr("mqslam.formats.recordings.oxford.open_rows", fail)
        said = f"{drive}: is damaged or of another kind (OverflowError: Python int too large to convert to C long)"
        assert_refused(run_quickly(drive, tmp_path / "out"), said)
        assert_refused(mqslam("info", drive), said)
    bag = write_bag(open_recording(write_oxford(tmp_path / "few")), bag_path(tmp_path, "mcap"), "mcap")
    monkeypatch.setattr("mqslam.formats.recordings.rosbag._read_index", fail)
    assert_refused(mqslam("info", bag), f"{bag}: ", "Python int too large")
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("attack", ["object/apply", "object/new", "name"])
def test_yaml_that_would_execute(drive: Path, tmp_path: Path, attack: str) -> None:
    touched, evil, kiss = tmp_path / "executed", tmp_path / "evil.yaml", tmp_path / "kiss.yaml"
    text = f"psi: !!python/{attack}:os.system ['touch {touched}']\n"
    evil.write_text(text)
    assert_refused(mqslam("run", drive, "--out", tmp_path / "out", "--config", evil), "evil.yaml: is not a readable YAML")
    kiss.write_text(f"kiss_icp: {{config_file: {evil}}}\n")
    words = ["--frontend", "kiss_icp", "--config", kiss, "--quiet"]
    assert_refused(mqslam("run", drive, "--out", tmp_path / "out", *words), "evil.yaml: is not a YAML file")
    evil.write_text("# " + "x" * 300_000)
    assert_refused(mqslam("run", drive, "--out", tmp_path / "out", *words), "evil.yaml: is larger than 0.3 MB")
    evil.write_text(text)
    bag = write_bag(open_recording(write_oxford(tmp_path / "few")), bag_path(tmp_path, "ros2"), "ros2")
    (bag / "metadata.yaml").write_text("rosbag2_bagfile_information: " + text)
    assert_refused(run_quickly(bag, tmp_path / "out"), f"{bag}: is not a readable bag")
    assert not touched.exists() and not (tmp_path / "out").exists()


class _Attack:
    def __init__(self, touched: Path) -> None:
        self.touched = touched

    def __reduce__(self) -> tuple[Callable[[str], int], tuple[str]]:
        return os.system, (f"touch {self.touched}",)


def test_a_pickle(drive: Path, tmp_path: Path) -> None:
    touched = tmp_path / "executed"
    attack = np.array([_Attack(touched)], dtype=object)
    for name, command in (("stamps_us", "run"), ("t", "audit")):
        file = tmp_path / f"{name}.npz"
        np.savez(file, **{name: attack, "x": attack, "y": attack})  # type: ignore[arg-type]
        words = ["--format", "native"] if command == "run" else []
        assert_refused(
            mqslam(command, file, "--out", tmp_path / "out", *words, "--quiet"), f"{name}.npz: ", "missing or damaged"
        )
    for suffix in ("npz", "bag", "mcap", "ply", "las", "pcd"):
        file = tmp_path / f"whole.{suffix}"
        file.write_bytes(pickle.dumps(_Attack(touched)))
        assert_refused(
            mqslam("audit", file, "--trajectory", "odometry", "--out", tmp_path / "out", "--quiet"), f"whole.{suffix}: "
        )
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("mqslam.slam.Problem", interrupt)
        assert run_quickly(drive, tmp_path / "out").code == 130
    for kept in (tmp_path / "out" / CHECKPOINT).glob("*.npz"):
        np.savez(kept, **{name: attack for name in ("ranges", "ends", "psi")})  # type: ignore[arg-type]
    assert run_quickly(drive, tmp_path / "out", "--resume", "--quiet").code == 0
    assert not touched.exists()


def test_bytes_that_are_damaged_anywhere() -> None:
    """Every reader is fuzzed: `tests/fuzz`, ten thousand inputs each by `MQSLAM_FUZZ=10000`."""
    assert set(FORMATS) <= {"rosbag" if name in ("ros1 bag", "mcap") else name.split()[0] for name in SUBJECTS}
