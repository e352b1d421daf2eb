"""What a user sees of each fault of the README's table, and what is kept: a test per row, named after its first cell."""

from __future__ import annotations

import gzip
import itertools
import json
import os
import pickle
import re
import shutil
import signal
import struct
import subprocess
import sys
import time
import zipfile
import zlib
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any

import gtsam
import numpy as np
import pytest
from PIL import Image
from support.clusters import Cluster, at
from support.commands import INSTALLED, Result, contents, mqslam, processes, strict_json
from support.conversions import write_jittered
from support.layouts import left_turn, write_radiate
from support.parameters import mostly_slow
from support.recordings import START_US, TURN_US, bag_path, raw_rows, with_metadata, write_bag, write_oxford, write_png

from mqslam.backend.pose_graph import PoseCovariances, PoseGraph, compute_marginals
from mqslam.cli import main
from mqslam.config import Config
from mqslam.core import frontend, se2
from mqslam.core.frontend import Context
from mqslam.core.measurement import Measurement, Status
from mqslam.core.recording import Recording
from mqslam.core.scans import Scan
from mqslam.detection import stage as detection
from mqslam.detection.stage import detect_all
from mqslam.errors import DataError
from mqslam.execution import engine
from mqslam.execution.checkpoint import FOLDER
from mqslam.execution.engine import LocalEngine
from mqslam.execution.runner import Runner
from mqslam.formats.recordings import FORMATS, open_recording
from mqslam.formats.shared import images as images_module
from mqslam.formats.shared.images import decode_grey
from mqslam.formats.tum import read_tum, write_tum
from mqslam.formats.writing import oxford as writer
from mqslam.simulator import SensorModel, SimulatedRecording, loop_drive, simulated_recording, street_scene

README = Path(__file__).parents[1] / "README.md"
QUICK = ("--odometry", "none", "--jobs", "1")


def test_every_row_of_the_readme_has_its_test() -> None:
    last = README.read_text(encoding="utf-8").split("\n## ")[-1]
    assert last.startswith("Faults\n"), "the table of faults is the README's last section"
    rows = [line.split("|")[1].strip() for line in last.splitlines() if line.startswith("|")][2:]
    assert len(rows) > 10
    for row in rows:
        name = "test_" + re.sub(r"[^a-z0-9]+", "_", row.replace("`", "").lower()).strip("_")
        assert callable(globals().get(name)), f"the fault '{row}' has no {name}"


@pytest.fixture(scope="module")
def lane(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Thirty coarse revolutions of a street, with ground truth; nobody may change it."""
    folder = tmp_path_factory.mktemp("lane") / "drive"
    write(folder, small_street(4.0, 7.5))
    return folder


def small_street(turn_rate_hz: float, duration_s: float) -> SimulatedRecording:
    sensor = SensorModel(turn_rate_hz=turn_rate_hz, azimuths=200, range_resolution=0.175, max_range=60.0)
    return simulated_recording(street_scene(1, movers=0), loop_drive(duration_s), duration_s=duration_s, sensor=sensor)


def write(folder: Path, recording: Recording) -> None:
    """Write a stream in the Oxford layout."""
    folder.mkdir(parents=True)
    writer.write(folder, recording)


@pytest.fixture
def drive(lane: Path, tmp_path: Path) -> Path:
    """A copy of the lane that a test may damage."""
    return shutil.copytree(lane, tmp_path / "drive")


def images(drive: Path) -> list[Path]:
    return sorted((drive / "radar").glob("*.png"))


def cut(image: Path) -> None:
    """Leave the beginning of an image, as a full disk or a broken copy does."""
    image.write_bytes(image.read_bytes()[:1500])


def run(drive: Path, out: Path, *more: str | Path) -> Result:
    quick = drive.parent / "quick.yaml"
    quick.write_text("sensor: {doppler_beta: 0.0}\nloops: {enabled: false}\n")
    return mqslam("run", drive, "--out", out, "--config", quick, *QUICK, *more)


def summary(out: Path) -> dict[str, dict[str, float]]:
    found: dict[str, dict[str, float]] = json.loads((out / "summary.json").read_text())
    return found


def refused(shown: Result, *words: str) -> None:
    """The command ended with one line that says all the words."""
    assert shown.code == 2, shown.err
    line = shown.err.splitlines()[-1]
    assert line.startswith("mqslam: error: ") and all(word in line for word in words), line
    assert "Traceback" not in shown.err


def test_an_image_that_cannot_be_read(drive: Path, tmp_path: Path) -> None:
    broken = images(drive)[11:14]
    for image in broken:
        cut(image)
    shown = run(drive, tmp_path / "out")
    assert shown.code == 0
    warning = f"warning: 3 polar scans could not be read and are left out: {broken[0]}: is not a readable PNG"
    assert warning in shown.err and str(broken[2]) in shown.err
    found = summary(tmp_path / "out")
    assert found["dataset"]["unread"] == 3 and "3 of 30 revolutions could not be read" in str(found["verdict"])
    assert "3 polar scans could not be read" in (tmp_path / "out" / "report.html").read_text()
    track = read_tum(tmp_path / "out" / "trajectory.tum")
    assert track.stamps_us.tolist() == [int(image.stem) for image in images(drive)]
    assert found["evaluation"]["ate_rmse_m"] < 0.5
    before = contents(tmp_path)
    refused(run(drive, tmp_path / "strict", "--strict", "--quiet"), f"{broken[0]}: is not a readable PNG")
    assert contents(tmp_path) == before


def test_an_unread_revolution_stays_one_when_a_run_is_resumed(drive: Path, tmp_path: Path) -> None:
    """Not a row of its own: what an interrupted run could not read is known to the run that continues it."""
    from mqslam import slam as slam_module

    cut(images(drive)[11])
    assert run(drive, tmp_path / "whole").code == 0
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(slam_module, "optimise", interrupted)
        assert run(drive, tmp_path / "out").code == 130
    shown = run(drive, tmp_path / "out", "--resume")
    assert shown.code == 0 and "1 polar scan could not be read and is left out" in shown.err
    for name in ("trajectory.tum", "measurements.csv", "map.ply"):
        assert (tmp_path / "out" / name).read_bytes() == (tmp_path / "whole" / name).read_bytes()


def interrupted(*_: object) -> None:
    raise KeyboardInterrupt


def test_a_first_or_last_image_that_cannot_be_read(drive: Path, tmp_path: Path) -> None:
    first, second, *_, last = images(drive)
    for image in (first, second, last):
        cut(image)
    shown = run(drive, tmp_path / "out")
    assert shown.code == 0
    assert f"the first 2 revolutions could not be read, left out: {first}: " in shown.err
    assert f"the last revolution could not be read, left out: {last}: " in shown.err
    assert len(read_tum(tmp_path / "out" / "trajectory.tum")) == 27
    refused(run(drive, tmp_path / "strict", "--strict"), str(first))


def test_over_half_of_the_images_cannot_be_read(drive: Path, tmp_path: Path) -> None:
    for image in images(drive)[3:22]:
        cut(image)
    before = contents(tmp_path)
    refused(run(drive, tmp_path / "out", "--quiet"), "is not a readable PNG", "like 19 of 30 polar scans")
    assert contents(tmp_path).keys() - before.keys() == {"quick.yaml"}


@pytest.mark.parametrize("name", ["odom.csv", "gt/poses_tum.txt"])
@pytest.mark.parametrize("text", ["t,v,omega\n1,2\n", "", "1 0 0 0 0 0 0 1\n", "\x00"])
def test_odometry_poses_or_ground_truth_beside_the_images_that_cannot_be_used(tmp_path: Path, name: str, text: str) -> None:
    drive = write_oxford(tmp_path / "drive")
    (drive / "gt").mkdir()
    (drive / name).write_text(text)
    shown = mqslam("info", drive)
    assert shown.code == 0 and f"{drive / name} " in shown.out and ": left out" in shown.out
    recording = open_recording(drive)
    assert recording.odometry is None and recording.ground_truth is None and len(recording) == 6
    refused(mqslam("run", drive, "--out", tmp_path / "out", "--strict"), str(drive / name), ": left out")


def test_azimuths_that_are_missing(drive: Path, tmp_path: Path) -> None:
    for k, rows in ((9, 120), (15, 12)):  # of 200
        image = images(drive)[k]
        with Image.open(image) as whole:
            pixels = np.asarray(whole)[:rows]
        Image.fromarray(pixels).save(image)
    recording = open_recording(drive)
    assert recording[9].power.shape[0] == 120 and len(recording) == 30
    shown = run(drive, tmp_path / "out")
    assert shown.code == 0 and "1 polar scan could not be read" in shown.err
    assert f"{images(drive)[15]}: has 12 azimuths, the first image 200" in shown.err


def test_revolutions_that_are_missing(drive: Path, tmp_path: Path) -> None:
    for image in images(drive)[12:16]:
        image.unlink()
    shown = run(drive, tmp_path / "out")
    assert shown.code == 0 and "warning: radar gap of 1.00 s after scan 11" in shown.err
    assert len(read_tum(tmp_path / "out" / "trajectory.tum")) == 26
    assert summary(tmp_path / "out")["evaluation"]["ate_rmse_m"] < 0.5


def test_stamps_that_repeat_or_run_backward(drive: Path, tmp_path: Path) -> None:
    expected = open_recording(drive)
    listing = drive / "radar.timestamps"
    lines = listing.read_text().splitlines()
    listing.write_text("\n".join([*lines[5:], *lines[:5], lines[7]]) + "\n")
    assert open_recording(drive).stamps_us.tolist() == expected.stamps_us.tolist()
    shown = run(drive, tmp_path / "out")
    assert shown.code == 0 and "radar.timestamps runs backward 1 times" in shown.err
    assert "radar.timestamps lists 1 stamps more than once" in shown.err
    refused(run(drive, tmp_path / "strict", "--strict"), "runs backward")
    bag = write_stray(tmp_path, expected)
    assert open_recording(bag).stamps_us.tolist() == np.delete(expected.stamps_us, 4).tolist()
    assert "the stamps of 1 messages on /Navtech/Polar repeat or run backward" in open_recording(bag).faults[0]
    listing = write_radiate(tmp_path / "city", left_turn()) / "Navtech_Polar.txt"
    listing.write_text(re.sub(r"(Frame: 000004 Time: )\d+", r"\g<1>1234567890", listing.read_text()))
    assert "the stamp of frame 000004 repeats or runs backward" in open_recording(tmp_path / "city").faults[0]


def write_stray(folder: Path, recording: Recording) -> Path:
    """A bag whose fifth message is stamped an hour too late."""
    from support.recordings import bag_writer

    with bag_writer(folder / "drive.bag", "ros1") as bag:
        radar = bag.topic("/Navtech/Polar", "sensor_msgs/msg/Image")
        for k, (stamp, rows) in enumerate(raw_rows(recording)):
            late = 3_600_000_000 if k == 4 else 0
            stamps = rows[:, :8].copy().view("<i8")[:, 0] + late
            ticks = rows[:, 8:10].copy().view("<u2")[:, 0].astype(np.int64)
            image = with_metadata(rows[:, 11:], stamps, ticks, rows[:, 10] == 255)
            bag.write(radar, stamp, bag.image(stamp + late, image))
    return folder / "drive.bag"


def test_stamps_of_arrival_that_jitter(tmp_path: Path) -> None:
    delays = np.random.default_rng(1).uniform(0.0, 20_000.0, 60)
    drive = write_jittered(tmp_path, "radiate", delays)
    shown = mqslam("info", drive)
    assert shown.code == 0 and "the arrival stamps jitter more than a turning radar can: they are smoothed" in shown.out
    assert np.abs(np.diff(open_recording(drive).stamps_us[1:]) - TURN_US).max() < 1000


def test_a_clock_that_jumps(drive: Path, tmp_path: Path) -> None:
    whole = open_recording(drive)
    assert whole.ground_truth is not None
    truth = whole.ground_truth.at(whole.stamps_us)
    for image in images(drive)[15:]:
        with Image.open(image) as whole:
            rows = np.asarray(whole)
        stamps = rows[:, :8].copy().view("<i8")[:, 0] + 7_200_000_000
        image.unlink()
        write_png(drive, np.hstack([stamps[:, None].view(np.uint8).reshape(len(rows), 8), rows[:, 8:]]))
    (drive / "radar.timestamps").unlink()
    shown = run(drive, tmp_path / "out")
    assert shown.code == 0
    assert "warning: jump of the clock or pause of 7200.00 s after scan 14" in shown.err
    track = read_tum(tmp_path / "out" / "trajectory.tum")
    assert len(track) == 30 and np.abs(track.poses[:, :2]).max() < 200.0  # two hours at this speed would be 50 km
    for half in (slice(0, 15), slice(19, 30)):
        moves, expected = (se2.between(poses[half][:-1], poses[half][1:]) for poses in (track.poses, truth))
        np.testing.assert_allclose(moves[:, 0], expected[:, 0], rtol=0.0, atol=0.3)


def test_a_turn_rate_that_changes(tmp_path: Path) -> None:
    slow, fast = small_street(2.0, 12.0), small_street(4.0, 12.0)
    drive = tmp_path / "drive"
    (drive / "radar").mkdir(parents=True)
    halfway = slow.start_us + 6_000_000
    for recording, chosen in ((slow, slow.stamps_us < halfway), (fast, fast.stamps_us >= halfway)):
        for k in np.flatnonzero(chosen).tolist():
            writer.write_polar_scan(drive, recording, k, recording[k])
    (drive / "simulation.json").write_text('{"range_resolution_m": 0.175}')
    shutil.copytree(write_truth(tmp_path, fast), drive / "gt")
    recording = open_recording(drive)
    assert len(recording) == 12 + 24 and recording.gaps() == []
    scans, _ = detect_all(recording, Config().detector)
    assert [round(w.t1 - w.t0, 3) for w in scans] == [0.5] * 12 + [0.25] * 24
    shown = run(drive, tmp_path / "out")
    assert shown.code == 0 and "gap" not in shown.err
    assert "lost track" not in shown.err and summary(tmp_path / "out")["evaluation"]["ate_rmse_m"] < 0.5


def write_truth(folder: Path, recording: Recording) -> Path:
    (folder / "truth").mkdir()
    writer.write_beside(folder / "truth", recording)
    return folder / "truth" / "gt"


@pytest.mark.parametrize("kind", ["bag", "mcap", "npz", "odometry", "settings"])
def test_a_file_cut_short(drive: Path, tmp_path: Path, kind: str) -> None:
    if kind == "npz":
        from mqslam.formats.recordings.native import write_native

        file = tmp_path / "drive.npz"
        write_native(file, open_recording(drive))
        arguments: list[str | Path] = [file]
    elif kind in ("odometry", "settings"):
        file = tmp_path / kind
        text = {"odometry": f"t,v,omega\n{START_US},1,0\n{START_US + 10},1", "settings": "psi: {beta_s: 1"}[kind]
        file.write_text(text)
        arguments = [drive, "--odometry" if kind == "odometry" else "--config", file]
    else:
        layout = "ros1" if kind == "bag" else kind
        file = write_bag(open_recording(drive), bag_path(tmp_path, layout), layout)
        arguments = [file]
    if kind not in ("odometry", "settings"):
        file.write_bytes(file.read_bytes()[: file.stat().st_size // 2])
    before = contents(tmp_path)
    refused(mqslam("run", *arguments, "--out", tmp_path / "out", "--quiet"), str(file))
    assert contents(tmp_path) == before


@pytest.mark.slow
@pytest.mark.parametrize("layout", ["oxford", "radiate"])
def test_a_recording_of_twelve_hours(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, layout: str) -> None:
    """170,000 revolutions: opening reads names and two images, and what a worker is sent does not grow with them."""
    count = 170_000
    if layout == "oxford":
        drive = write_oxford(tmp_path / "drive", revolutions=2)
        first, last = images(drive)
        stamps = START_US + TURN_US * np.arange(count)
        for stamp in stamps[1:-1].tolist():
            (drive / "radar" / f"{stamp}.png").touch()
        with Image.open(first) as image:
            rows = np.asarray(image)
        times = rows[:, :8].copy().view("<i8")[:, 0] + TURN_US * (count - 1)
        write_png(drive, np.hstack([times[:, None].view(np.uint8).reshape(len(rows), 8), rows[:, 8:]]))
        last.touch()
        (drive / "radar.timestamps").write_text("".join(f"{stamp} 1\n" for stamp in stamps.tolist()))
    else:
        drive = write_radiate(tmp_path / "drive", left_turn())
        for k in range(7, count + 1):
            (drive / "Navtech_Polar" / f"{k:06d}.png").touch()
        lines = [f"Frame: {k:06d} Time: {1_600_000_000 + 0.25 * k:.9f}\n" for k in range(1, count + 1)]
        (drive / "Navtech_Polar.txt").write_text("".join(lines))
    decoded: list[object] = []

    def counted(source: object, formats: tuple[str, ...]) -> Any:
        decoded.append(source)
        return decode_grey(source, formats)  # type: ignore[arg-type]

    monkeypatch.setattr(images_module, "decode_grey", counted)
    recording = open_recording(drive)
    assert len(recording) == count and recording.gaps() == [] and 1 <= len(set(decoded)) <= 2


def test_workers_are_sent_a_recordings_index_once(lane: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Not a row of its own: that of twelve hours has megabytes, and there are thousands of stretches."""
    sent: list[int] = []

    class Spied(ProcessPoolExecutor):
        def submit(self, work: Any, /, *words: Any, **named: Any) -> Any:
            sent.append(len(pickle.dumps((work, words, named))))
            return super().submit(work, *words, **named)

    alone, _ = detect_all(open_recording(lane), Config().detector)
    monkeypatch.setattr(engine, "ProcessPoolExecutor", Spied)
    monkeypatch.setattr(engine, "_WORTH_PROCESSES", 1)
    monkeypatch.setattr(detection, "_CHUNK", 4)
    scans, _ = detect_all(open_recording(lane), Config().detector, Runner(LocalEngine(2)))
    assert len(sent) == 8 and max(sent) < 200
    for one, other in zip(alone, scans, strict=True):
        np.testing.assert_array_equal(one.returns.ranges, other.returns.ranges)


def test_an_output_that_is_read_only(drive: Path, tmp_path: Path) -> None:
    before = contents(drive)
    for out in (Path("/proc/out"), Path("/sys/out")):
        refused(run(drive, out), str(out), "cannot be made", "choose another --out")
        refused(mqslam("simulate", out, "--duration", "1", "--quiet"), str(out))
    with mounted(tmp_path / "disk", "8m") as disk:
        (disk / "mine").write_text("kept")
        subprocess.run(["mount", "-o", "remount,ro", disk], check=True)
        refused(run(drive, disk / "out"), f"{disk}/out: cannot be", "choose another --out")
        assert contents(disk) == {"mine": b"kept"}
    assert contents(drive) == before


class mounted:
    """A small file system of its own, where the tests may mount one."""

    def __init__(self, place: Path, size: str) -> None:
        self.place, self.size = place, size

    def __enter__(self) -> Path:
        self.place.mkdir()
        options = ["-t", "tmpfs", "-o", f"size={self.size}", "tmpfs", self.place]
        if not shutil.which("mount") or subprocess.run(["mount", *options], capture_output=True).returncode != 0:
            pytest.skip("may not mount a file system here")
        return self.place

    def __exit__(self, *error: object) -> None:
        subprocess.run(["umount", "--lazy", self.place], check=False)


@pytest.mark.parametrize("size_kb", [8, 64, 300, 900])
def test_a_full_disk(drive: Path, tmp_path: Path, size_kb: int) -> None:
    """At several sizes, so that it is full before, in and after the checkpoint."""
    with mounted(tmp_path / "disk", f"{size_kb}k") as disk:
        shown = run(drive, disk / "out", "--quiet")
        refused(shown, str(disk), "No space left on device", "free space")
        left = contents(disk)
        assert all(name == "out" or name.startswith(f"out/{FOLDER}") for name in left), left
        kept = [name for name in left if name.endswith(".npz")]
        assert ("continue with --resume" in shown.err) == bool(kept)
        if kept:
            subprocess.run(["mount", "-o", "remount,size=64m", disk], check=True)
            assert run(drive, disk / "out", "--resume", "--quiet").code == 0
            assert FOLDER not in {path.name for path in (disk / "out").iterdir()}
    with mounted(tmp_path / "other", "300k") as disk:
        refused(mqslam("simulate", disk / "sim", "--duration", "3", "--quiet"), "No space left on device")
        assert contents(disk) == {}


INTERRUPTS = list(itertools.product(("run", "compare", "audit", "simulate"), (signal.SIGINT, signal.SIGTERM)))


@pytest.mark.parametrize(("command", "number"), mostly_slow(INTERRUPTS, [("run", signal.SIGINT), ("audit", signal.SIGTERM)]))
def test_ctrl_c_or_sigterm(drive: Path, tmp_path: Path, command: str, number: signal.Signals) -> None:
    """To all processes of the terminal, as Ctrl-C is, or to the command alone, as kill does."""
    folder = tmp_path / "results"
    folder.mkdir()
    arguments = {
        "run": ["run", drive, "--out", folder / "out"],
        "compare": ["compare", drive, "--out", folder / "out", "--frontends", "psi"],
        "audit": ["audit", drive, "--trajectory", "ground_truth", "--out", folder / "out"],
        "simulate": ["simulate", folder / "out", "--duration", "120"],
    }[command]
    process = subprocess.Popen(
        [INSTALLED, *arguments],
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),  # what runs the tests may ignore it
    )
    assert process.stderr is not None
    shown = [process.stderr.readline()]
    while shown[-1] and not re.match("reading and detecting: 30/30|simulating", shown[-1]):
        shown.append(process.stderr.readline())
    time.sleep(0.2)
    (os.killpg if number is signal.SIGINT else os.kill)(process.pid, number)
    rest = process.stderr.read()
    assert process.wait(timeout=300) == 128 + number, rest
    last = rest.splitlines()[-1]
    assert "Traceback" not in rest
    if command in ("run", "compare"):
        assert last == "mqslam: interrupted; continue with --resume"
        assert {path.name for path in (folder / "out").iterdir()} == {FOLDER}
    else:
        assert last == "mqslam: interrupted" and list(folder.iterdir()) == []
    assert processes(process.pid) == []


def test_a_signal_during_an_import_is_an_interrupt(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Not a row of its own: libraries make other errors of it."""

    def interrupted_import(**_: object) -> None:
        try:
            os.kill(os.getpid(), signal.SIGTERM)
            time.sleep(1.0)
        except BaseException as error:
            raise ImportError("initialization failed") from error

    monkeypatch.setattr("mqslam.cli.app", interrupted_import)
    with pytest.raises(SystemExit) as ended:
        main()
    assert ended.value.code == 143 and capsys.readouterr().err == "mqslam: interrupted\n"


def big_png(width: int, height: int) -> bytes:
    """An image of zeros, which packs a thousandfold."""

    def chunk(kind: bytes, content: bytes) -> bytes:
        return struct.pack(">I", len(content)) + kind + content + struct.pack(">I", zlib.crc32(kind + content))

    packer = zlib.compressobj(9)
    row = bytes(width + 1)
    body = b"".join(packer.compress(row) for _ in range(height)) + packer.flush()
    head = struct.pack(">IIBBBBB", width, height, 8, 0, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + chunk(b"IDAT", body) + chunk(b"IEND", b"")


def test_a_file_that_would_unpack_to_gigabytes(drive: Path, tmp_path: Path) -> None:
    bomb = images(drive)[7]
    bomb.write_bytes(big_png(9000, 9000))
    shown = peak_mb(lambda: refused(run(drive, tmp_path / "out", "--strict", "--quiet"), str(bomb)))
    bomb.write_bytes(big_png(60_000, 60).replace(struct.pack(">II", 60_000, 60), struct.pack(">II", 60_000, 60_000)))
    shown = max(shown, peak_mb(lambda: refused(run(drive, tmp_path / "out", "--strict", "--quiet"), str(bomb))))
    archive = tmp_path / "bomb.npz"
    with zipfile.ZipFile(archive, "w", zipfile.ZIP_DEFLATED) as file, file.open("stamps_us.npy", "w") as member:
        np.lib.format.write_array_header_1_0(member, {"descr": "<i8", "fortran_order": False, "shape": (25 * 10**6,)})
        for _ in range(200):
            member.write(bytes(10**6))
    for command in ("run", "audit"):
        words = [command, archive, "--out", tmp_path / "out", "--quiet"]
        shown = max(shown, peak_mb(lambda words=words: refused(mqslam(*words), "bomb.npz: would unpack to 200 MB")))
    log = tmp_path / "bomb.log.gz"
    with gzip.open(log, "wb", 9) as file:
        for _ in range(50):
            file.write(b"ODOM 0 0 0 0 0 0 1.0 host 1.0\n" * 33_000)
    words = ["audit", log, "--out", tmp_path / "out", "--quiet"]
    shown = max(shown, peak_mb(lambda: refused(mqslam(*words), "bomb.log.gz: unpacks to more than")))
    assert shown < 150.0


def peak_mb(work: Callable[[], None]) -> float:
    """Memory that a piece of work takes at its worst [MB]."""
    Path("/proc/self/clear_refs").write_text("5")
    before = _megabytes("VmRSS")
    work()
    return _megabytes("VmHWM") - before


def _megabytes(name: str) -> float:
    lines = Path("/proc/self/status").read_text().splitlines()
    return next(int(line.split()[1]) / 1000.0 for line in lines if line.startswith(name))


def test_a_name_that_leaves_the_recording(drive: Path, tmp_path: Path) -> None:
    secret = tmp_path / "secret"
    secret.mkdir()
    image = images(drive)[7]
    shutil.move(image, secret / image.name)
    listing = drive / "radar.timestamps"
    listed = listing.read_text()
    listing.write_text(listed + f"../../secret/{image.stem} 1\n")
    refused(run(drive, tmp_path / "out"), "radar.timestamps: has lines other than '<t> 1'")
    listing.write_text(listed)
    image.symlink_to(secret / image.name)
    refused(run(drive, tmp_path / "out"), f"{image}: is a link out of the recording")
    city = write_radiate(tmp_path / "city", left_turn())
    text = (city / "Navtech_Polar.txt").read_text()
    (city / "Navtech_Polar.txt").write_text(text.replace("Frame: 000003", "Frame: ../../3"))
    refused(run(city, tmp_path / "out"), "line 3 is not 'Frame: 000001 Time: ")
    (city / "Navtech_Polar.txt").write_text(text)
    (city / "Navtech_Polar" / "000003.png").rename(secret / "000003.png")
    (city / "Navtech_Polar" / "000003.png").symlink_to(secret / "000003.png")
    refused(run(city, tmp_path / "out"), "000003.png: is a link out of the recording")
    bag = write_bag(open_recording(write_oxford(tmp_path / "few")), bag_path(tmp_path, "ros2"), "ros2")
    file = next(bag.glob("*.db3"))
    file.rename(secret / file.name)
    metadata = bag / "metadata.yaml"
    metadata.write_text(metadata.read_text().replace(file.name, f"../secret/{file.name}"))
    refused(run(bag, tmp_path / "out"), f"{bag}: is not a readable bag")
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("attack", ["object/apply", "object/new", "name"])
def test_yaml_that_would_execute(drive: Path, tmp_path: Path, attack: str) -> None:
    touched, evil, kiss = tmp_path / "executed", tmp_path / "evil.yaml", tmp_path / "kiss.yaml"
    text = f"psi: !!python/{attack}:os.system ['touch {touched}']\n"
    evil.write_text(text)
    refused(mqslam("run", drive, "--out", tmp_path / "out", "--config", evil), "evil.yaml: is not a readable YAML")
    kiss.write_text(f"kiss_icp: {{config_file: {evil}}}\n")
    words = ["--frontend", "kiss_icp", "--config", kiss, "--quiet"]
    refused(mqslam("run", drive, "--out", tmp_path / "out", *words), "evil.yaml: is not a YAML file")
    bag = write_bag(open_recording(write_oxford(tmp_path / "few")), bag_path(tmp_path, "ros2"), "ros2")
    (bag / "metadata.yaml").write_text("rosbag2_bagfile_information: " + text)
    refused(run(bag, tmp_path / "out"), f"{bag}: is not a readable bag")
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
        refused(mqslam(command, file, "--out", tmp_path / "out", *words, "--quiet"), f"{name}.npz: ", "missing or damaged")
    for suffix in ("npz", "bag", "mcap", "ply", "las", "pcd"):
        file = tmp_path / f"whole.{suffix}"
        file.write_bytes(pickle.dumps(_Attack(touched)))
        refused(mqslam("audit", file, "--trajectory", "odometry", "--out", tmp_path / "out", "--quiet"), f"whole.{suffix}: ")
    with pytest.MonkeyPatch.context() as patch:
        from mqslam import slam as slam_module

        patch.setattr(slam_module, "optimise", interrupted)
        assert run(drive, tmp_path / "out").code == 130
    for kept in (tmp_path / "out" / FOLDER).glob("*.npz"):
        np.savez(kept, **{name: attack for name in ("ranges", "ends", "psi")})  # type: ignore[arg-type]
    assert run(drive, tmp_path / "out", "--resume", "--quiet").code == 0
    assert not touched.exists()


def test_bytes_that_are_damaged_anywhere() -> None:
    """Every reader is fuzzed: `tests/fuzz`, ten thousand inputs each by `MQSLAM_FUZZ=10000`."""
    from support.subjects import SUBJECTS

    assert set(FORMATS) <= {"rosbag" if name in ("ros1 bag", "mcap") else name.split()[0] for name in SUBJECTS}


@pytest.mark.slow
def test_a_worker_of_a_cluster_that_dies(
    drive: Path, tmp_path: Path, crew: Cluster, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert run(drive, tmp_path / "alone").code == 0
    left = at(monkeypatch, "detect", crew.workers[0].kill)
    shown = run(drive, tmp_path / "out", "--cluster", crew.address, "--quiet")
    assert (shown.code, shown.err) == (0, "")
    assert left[0] >= 8 and crew.workers[0].wait() == -signal.SIGKILL and crew.workers[1].poll() is None
    for name in ("trajectory.tum", "measurements.csv", "map.ply"):
        assert (tmp_path / "out" / name).read_bytes() == (tmp_path / "alone" / name).read_bytes(), name


@pytest.mark.slow
def test_a_cluster_that_is_lost(drive: Path, tmp_path: Path, crew: Cluster, monkeypatch: pytest.MonkeyPatch) -> None:
    assert run(drive, tmp_path / "alone").code == 0
    with monkeypatch.context() as patch:
        at(patch, "detect", crew.scheduler.kill)
        shown = run(drive, tmp_path / "out", "--cluster", crew.address)
    refused(shown, f"{crew.address}: the connection to the scheduler is lost; continue with --resume")
    assert {path.name for path in (tmp_path / "out").iterdir()} == {FOLDER}
    assert run(drive, tmp_path / "out", "--resume").code == 0
    assert (tmp_path / "out" / "trajectory.tum").read_bytes() == (tmp_path / "alone" / "trajectory.tum").read_bytes()


@pytest.mark.slow
class Tunnel:
    """Motions as a bare tunnel tells them: to a hair across, and not at all along."""

    def __init__(self, context: Context) -> None: ...

    def measure(self, scans: list[Scan]) -> Iterator[Measurement]:
        for a, b in itertools.pairwise(scans):
            axes = np.array([[np.cos(0.3), -np.sin(0.3), 0.0], [np.sin(0.3), np.cos(0.3), 0.0], [0.0, 0.0, 1.0]])
            covariance = axes @ np.diag([1e10, 1e-10, 1e-10]) @ axes.T
            yield Measurement(a.t0, b.t0, np.array([2.0, 0.0, 0.0]), covariance, Status.DEGENERATE)


@pytest.mark.parametrize("odometry", ["none", "wheels"])
def test_a_tunnel_that_tells_nothing_along_it(
    drive: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, odometry: str
) -> None:
    wheels = tmp_path / "wheels.tum"
    write_tum(wheels, open_recording(drive).ground_truth)
    load, seen = frontend.load, []

    def watched(found: PoseGraph, values: gtsam.Values, indices: list[int]) -> PoseCovariances:
        seen.append((found.factors, values))
        return compute_marginals(found, values, indices)

    monkeypatch.setattr(frontend, "load", lambda name: Tunnel if name == "psi" else load(name))
    monkeypatch.setattr("mqslam.report.run_page.compute_marginals", watched)
    shown = run(drive, tmp_path / "out", "--odometry", wheels if odometry == "wheels" else "none")
    assert shown.code == 0 and "warning: did not observe every direction from 0.0 s to 7.2 s" in shown.err
    assert "could not be made" not in shown.err and "the report shows no ellipses" not in shown.err
    assert (tmp_path / "out" / "report.html").is_file() and (tmp_path / "out" / "trajectory.tum").is_file()
    if odometry == "none":  # where GTSAM's own marginals end with an exception
        with pytest.raises(RuntimeError, match="Indeterminate linear system"):
            gtsam.Marginals(*seen[0])


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 2])  # of the first the covariances are beyond GTSAM's own marginals
def test_the_twins_tunnel(tmp_path: Path, seed: int) -> None:
    """Poles, 220 m of bare walls, poles."""
    twin = Path(__file__).parents[2] / "shared" / "twin"
    if not twin.is_dir():
        pytest.skip(f"the twin is not at {twin}")
    tunnel = tmp_path / "tunnel"
    subprocess.run([sys.executable, twin / "worlds.py", tmp_path / "worlds"], check=True)
    words = ["tunnel", tunnel, "--data", tmp_path / "worlds", "--seed", str(seed)]
    subprocess.run([sys.executable, twin / "make_twin.py", *words], check=True)
    for odometry in ("none", "auto"):
        out = tmp_path / odometry
        assert mqslam("run", tunnel, "--out", out, "--odometry", odometry, "--jobs", "1", "--quiet").code == 0
        found = strict_json((out / "summary.json").read_text())
        assert found["verdict"]["status"] in ("warn", "fail") and "every direction" in str(found["verdict"]["reasons"])
        assert not [warning for warning in found["warnings"] if "could not" in warning or "not known" in warning]
        assert "ellipses" in (out / "report.html").read_text(encoding="utf-8")


def test_a_recording_of_two_scans(drive: Path, tmp_path: Path) -> None:
    for image in images(drive)[2:]:
        image.unlink()
    stamps = drive / "radar.timestamps"
    stamps.write_text("".join(stamps.read_text().splitlines(keepends=True)[:2]))
    shown = run(drive, tmp_path / "out")
    assert shown.code == 0 and "verdict: not judged: 2 scans are too few to judge a map by: a window takes 6" in shown.out
    found = strict_json((tmp_path / "out" / "summary.json").read_text())
    assert found["verdict"]["status"] == "not judged" and found["inflation"]["windows"] == 0
    assert "not judged" in (tmp_path / "out" / "report.html").read_text()


def test_a_figure_or_a_report_that_cannot_be_made(drive: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Every file, stage and page is in `tests/cli/test_optional.py`."""

    def fail(*_: object) -> None:
        raise MemoryError

    monkeypatch.setattr("mqslam.report.run_page.write_report", fail)
    shown = run(drive, tmp_path / "out")
    assert shown.code == 0
    assert "warning: report.html could not be made (MemoryError); the other results are whole" in shown.err
    assert (tmp_path / "out" / "trajectory.tum").is_file() and not (tmp_path / "out" / "report.html").exists()


def test_a_run_of_a_batch_that_fails(drive: Path, tmp_path: Path) -> None:
    for image in images(shutil.copytree(drive, tmp_path / "broken")):
        cut(image)
    (tmp_path / "quick.yaml").write_text("sensor: {doppler_beta: 0.0}\n")
    (tmp_path / "runs.yaml").write_text("runs: [{data: broken}, {data: gone}, {data: drive, config: quick.yaml}]")
    shown = mqslam("batch", tmp_path / "runs.yaml", "--out", tmp_path / "out", "--jobs", "1", "--quiet")
    assert shown.code == 1 and "Traceback" not in shown.err
    first, second = shown.err.splitlines()
    assert first.startswith("broken failed: ") and "is not a readable PNG" in first
    assert second.startswith("gone failed: ") and "does not exist" in second
    names = {"drive", "batch.json", "batch.csv", "report.html"}
    assert {path.name for path in (tmp_path / "out").iterdir()} == names


def test_a_mistake_in_a_command(drive: Path, tmp_path: Path) -> None:
    """All of them are in `tests/cli/test_errors.py`."""
    before = contents(tmp_path)
    for words, said in (
        (["--frontend", "kiss_ipc"], "did you mean kiss_icp?"),
        (["--format", "oxfrod"], "did you mean 'oxford'?"),
        (["--odometry", tmp_path / "nothing.csv"], "nothing.csv"),
    ):
        refused(mqslam("run", drive, "--out", tmp_path / "out", "--quiet", *words), said)
    assert contents(tmp_path) == before


def test_a_run_that_was_killed(lane: Path, tmp_path: Path) -> None:
    """At every moment in `tests/cli/test_resume.py`."""
    drive = shutil.copytree(lane, tmp_path / "drive")
    assert run(drive, tmp_path / "whole", "--quiet").code == 0
    quick = tmp_path / "quick.yaml"
    out = tmp_path / "results" / "out"
    out.parent.mkdir()
    process = subprocess.Popen([INSTALLED, "run", drive, "--out", out, "--config", quick, *QUICK, "--quiet"])
    end = time.monotonic() + 600.0
    while process.poll() is None and not list(out.glob(f"{FOLDER}/returns-*.npz")) and time.monotonic() < end:
        time.sleep(0.002)
    process.kill()
    assert process.wait() == -signal.SIGKILL
    refused(run(drive, out), "--resume to continue the unfinished run")
    assert run(drive, out, "--resume", "--quiet").code == 0
    assert (out / "map.ply").read_bytes() == (tmp_path / "whole" / "map.ply").read_bytes()


def test_a_stretch_that_cannot_be_read_costs_no_more_than_itself(drive: Path) -> None:
    """Not a row of its own: reading goes on behind an error, in every layout's stream."""
    broken = [3, 4, 11, 29 - 1]
    for k in broken:
        cut(images(drive)[k])
    recording = open_recording(drive)
    good = detect_all(open_recording(lane_like(drive)), Config().detector)[0]
    scans, found = detect_all(recording, Config().detector)
    assert sorted(found.unread) == broken and all(isinstance(error, DataError) for error in found.unread.values())
    for k, (one, other) in enumerate(zip(scans, good, strict=True)):
        assert (one.t0, one.t1) == (other.t0, other.t1)
        assert len(one.returns) == (0 if k in broken else len(other.returns))


def lane_like(drive: Path) -> Path:
    """The undamaged drive that a copy was made of."""
    folder = drive.parent / "whole"
    write(folder, small_street(4.0, 7.5))
    return folder
