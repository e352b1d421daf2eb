"""A new layout is one module and one line in the registry; it may read only, or read and write."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from support.commands import mqslam

from mqslam.errors import ConfigError, DataError
from mqslam.execution.folders import CHECKPOINT, UNFINISHED_BATCH
from mqslam.formats.conversion import find_target
from mqslam.formats.recordings import FORMATS, list_targets, open_recording

READER = """
from dataclasses import replace

from mqslam.formats.recordings import native


def recognises(path):
    return path.suffix == ".toy"


def open_recording(path, sensing):
    return replace(native.open_recording(path, sensing), format="toy")
"""
WRITER = """

from mqslam.formats.recordings.layout import Target

TARGETS = (Target("toy", native.write, ".toy", odometry=True),)
"""


@pytest.fixture
def register(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, request: pytest.FixtureRequest) -> None:
    name = f"toy_layout_{request.node.name}"
    (tmp_path / f"{name}.py").write_text(READER + ("" if "reads_only" in name else WRITER))
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setitem(FORMATS, "toy", name)


def test_a_new_layout_is_read_and_written(register: None, oxford: Path, tmp_path: Path) -> None:
    shown = mqslam("convert", oxford, tmp_path / "drive.toy", "--quiet")
    assert shown.code == 0, shown.err
    recording = open_recording(tmp_path / "drive.toy")
    assert recording.format == "toy"
    np.testing.assert_array_equal(recording.stamps_us, open_recording(oxford).stamps_us)


def test_a_new_layout_that_reads_only_is_no_target(register: None, oxford: Path, tmp_path: Path) -> None:
    assert mqslam("convert", oxford, tmp_path / "drive.npz", "--quiet").code == 0
    (tmp_path / "drive.npz").rename(tmp_path / "drive.toy")
    assert open_recording(tmp_path / "drive.toy").format == "toy"
    assert "toy" not in {target.name for target in list_targets()}
    with pytest.raises(ConfigError, match="layout 'toy': is unknown; choose one of"):
        find_target(tmp_path / "out.toy", "toy")


def test_an_unknown_layout_is_answered_with_the_nearest(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"format 'rosbagg': is unknown; did you mean rosbag\?"):
        open_recording(tmp_path, "rosbagg")
    with pytest.raises(ConfigError, match=r"layout 'borea': is unknown; did you mean boreas\?"):
        find_target(tmp_path / "out", "borea")
    with pytest.raises(DataError, match="is an empty folder"):
        open_recording(tmp_path)


@pytest.mark.parametrize(
    "names",
    [
        ("summary.json", "config.yaml"),
        ("audit.json", "config.yaml"),
        ("batch.json", "batch.csv"),
        ("index.json", "keyframes.npy"),
    ],
)
def test_a_result_in_place_of_a_recording_is_named_as_one(tmp_path: Path, names: tuple[str, ...]) -> None:
    for name in names:
        (tmp_path / name).touch()
    with pytest.raises(DataError, match="is a result of mqslam, not a recording; give the recording that it was made from"):
        open_recording(tmp_path)


@pytest.mark.parametrize("content", [f"result/{CHECKPOINT}/run.json", f"result/{UNFINISHED_BATCH}"])
@pytest.mark.parametrize("command", ["info", "convert", "show"])
def test_unfinished_work_is_named_by_all_commands_in_the_same_words(tmp_path: Path, content: str, command: str) -> None:
    (tmp_path / content).parent.mkdir(parents=True)
    (tmp_path / content).touch()
    shown = mqslam(command, tmp_path / "result", *([tmp_path / "out.bag"] if command == "convert" else []))
    problem = (
        "result: holds work that is not finished, and no result yet; wait until the work has ended, or repeat its command"
    )
    assert shown.code == 2 and problem in shown.err and (CHECKPOINT in content) == ("--resume" in shown.err)
