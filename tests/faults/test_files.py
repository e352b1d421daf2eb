"""Files that are cut short, and recordings that are very long."""

from __future__ import annotations

import pickle
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image
from support.commands import mqslam, read_contents
from support.faults import assert_refused, images
from support.layouts import left_turn, write_radiate
from support.recordings import START_US, TURN_US, bag_path, write_bag, write_oxford, write_png

from mqslam.config import Config
from mqslam.detection import stage as detection
from mqslam.detection.stage import detect_all
from mqslam.execution import local_engine
from mqslam.execution.local_engine import LocalEngine
from mqslam.execution.runner import Runner
from mqslam.formats import images as images_module
from mqslam.formats.images import decode_grey
from mqslam.formats.recordings import open_recording


@pytest.mark.parametrize("kind", ["bag", "mcap", "npz", "odometry", "settings"])
def test_a_file_cut_short(drive: Path, tmp_path: Path, kind: str) -> None:
    if kind == "npz":
        from mqslam.formats.recordings.native import write as write_native

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
    before = read_contents(tmp_path)
    assert_refused(mqslam("run", *arguments, "--out", tmp_path / "out", "--quiet"), str(file))
    assert read_contents(tmp_path) == before


@pytest.mark.slow
@pytest.mark.parametrize("layout", ["oxford", "radiate"])
def test_a_recording_of_twelve_hours(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, layout: str) -> None:
    """170,000 polar scans: opening reads names and two images, and what a worker is sent does not grow with them."""
    count = 170_000
    if layout == "oxford":
        drive = write_oxford(tmp_path / "drive", polar_scans=2)
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
    """This has no row in the table of faults. The index of twelve hours has megabytes, and thousands of stretches use it."""
    sent: list[int] = []

    class Spied(ProcessPoolExecutor):
        def submit(self, work: Any, /, *words: Any, **named: Any) -> Any:
            sent.append(len(pickle.dumps((work, words, named))))
            return super().submit(work, *words, **named)

    alone, _ = detect_all(open_recording(lane), Config().detector)
    monkeypatch.setattr(local_engine, "ProcessPoolExecutor", Spied)
    monkeypatch.setattr(local_engine, "_WORTH_PROCESSES", 1)
    monkeypatch.setattr(detection, "_CHUNK", 4)
    scans, _ = detect_all(open_recording(lane), Config().detector, Runner(LocalEngine(2)))
    assert len(sent) == 8 and max(sent) < 200
    for one, other in zip(alone, scans, strict=True):
        np.testing.assert_array_equal(one.returns.ranges, other.returns.ranges)
