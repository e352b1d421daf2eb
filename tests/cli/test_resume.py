"""A run that is killed is continued by --resume and ends with the same bytes as one that was not.

At one moment in `tests/faults`; at every moment here, which is slow.
"""

from __future__ import annotations

import json
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from support.commands import mqslam, read_contents

from mqslam import slam as slam_module
from mqslam.detection import stage as detection
from mqslam.execution.folders import CHECKPOINT

OPTIONS = ("--odometry", "none", "--jobs", "1", "--quiet")
LATER = ("summary.json", "run.log", "report.html")  # say how long things took
MOMENTS = {
    "the first returns": f"out/{CHECKPOINT}/returns-000000-000040.npz",
    "the measurements": f"out/{CHECKPOINT}/measurements.npz",
    "the loops": f"out/{CHECKPOINT}/loops.npz",
    "the first results": ".out.unfinished/trajectory.tum",
}


@pytest.fixture(scope="module")
def whole(lap: Path) -> dict[str, bytes | None]:
    """What an uninterrupted run leaves."""
    assert run(lap, lap / "out").returncode == 0
    assert json.loads((lap / "out" / "summary.json").read_text())["factors"]["loop"] > 0
    return read_contents(lap / "out")


def command(lap: Path, out: Path, *more: str | Path) -> list[str | Path]:
    return ["run", lap / "drive", "--out", out, "--config", lap / "quick.yaml", *OPTIONS, *more]


def run(lap: Path, out: Path, *more: str | Path) -> subprocess.CompletedProcess[str]:
    """Runs a command in a process of its own."""
    words = [INSTALLED, *command(lap, out, *more)]
    return subprocess.run(words, capture_output=True, text=True, timeout=600)


INSTALLED = Path(sys.executable).with_name("mqslam")


def killed(lap: Path, folder: Path, moment: str) -> Path:
    """Kills a run as soon as a file appears below the parent of its results, and returns the result folder."""
    process = subprocess.Popen([INSTALLED, *command(lap, folder / "out")], stdout=subprocess.DEVNULL)
    end = time.monotonic() + 600.0
    while process.poll() is None and not list(folder.glob(moment)) and time.monotonic() < end:
        time.sleep(0.002)
    process.kill()
    assert process.wait() == -signal.SIGKILL, "the run was over before it could be killed"
    return folder / "out"


def assert_as_whole(out: Path, whole: dict[str, bytes | None]) -> None:
    """Checks that the results are those of the uninterrupted run, and that nothing lies in or beside them."""
    left = read_contents(out)
    assert left.keys() == whole.keys()
    for name in whole:
        assert name in LATER or left[name] == whole[name], name
    assert list(out.parent.iterdir()) == [out]


@pytest.mark.slow
@pytest.mark.parametrize("moment", MOMENTS)
def test_a_killed_run_is_resumed_to_the_same_bytes(
    lap: Path, whole: dict[str, bytes | None], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, moment: str
) -> None:
    out = killed(lap, tmp_path, MOMENTS[moment])
    reached = list(MOMENTS).index(moment)
    if reached >= 1:  # what was done is not done again
        monkeypatch.setattr(detection, "detect_stretch", lambda *_: pytest.fail("detected again"))
    if reached >= 2:
        monkeypatch.setattr(slam_module, "find_loops", lambda *_: pytest.fail("searched again"))
    shown = mqslam(*command(lap, out, "--resume"))
    assert shown.code == 0, shown.err
    assert_as_whole(out, whole)


@pytest.mark.slow
def test_a_run_killed_again_and_again_is_resumed_to_the_same_bytes(
    lap: Path, whole: dict[str, bytes | None], tmp_path: Path
) -> None:
    """By the clock, so that it may die anywhere, also before there is anything to resume."""
    out = tmp_path / "out"
    for wait_s in (0.3, 2.0):
        process = subprocess.Popen([INSTALLED, *command(lap, out, "--resume")], stdout=subprocess.DEVNULL)
        time.sleep(wait_s)
        process.kill()
        if process.wait() == 0:
            break
    else:
        assert mqslam(*command(lap, out, "--resume")).code == 0
    assert_as_whole(out, whole)


@pytest.mark.slow
def test_an_interrupted_run_says_so_and_can_be_resumed(
    lap: Path, whole: dict[str, bytes | None], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupted(*_: object) -> None:
        raise KeyboardInterrupt

    out = tmp_path / "out"
    with monkeypatch.context() as patch:
        patch.setattr(slam_module, "find_loops", interrupted)
        shown = mqslam(*command(lap, out))
    assert shown.code not in (0, 2) and "Traceback" not in shown.err
    assert {path.name for path in out.iterdir()} == {CHECKPOINT}
    assert mqslam(*command(lap, out, "--resume")).code == 0
    assert_as_whole(out, whole)


@pytest.fixture(scope="module")
def dead(lap: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An unfinished run; nobody may change it."""
    return killed(lap, tmp_path_factory.mktemp("dead"), MOMENTS["the first returns"])


@pytest.mark.parametrize(
    ("more", "said"),
    [
        ((), "--resume"),
        (("--resume", "--config", "other.yaml"), "unfinished run of other data or settings"),
        (("--resume", "--frontend", "kiss_icp"), "unfinished run of other data or settings"),
        (("--resume", "--odometry", "auto"), "unfinished run of other data or settings"),
    ],
)
def test_an_unfinished_run_is_neither_overwritten_unasked_nor_resumed_as_another(
    lap: Path, dead: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, more: tuple[str, ...], said: str
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("other.yaml").write_text("sensor: {doppler_beta: 0.01}\n")
    before = read_contents(dead.parent)
    shown = mqslam(*command(lap, dead, *more))
    assert shown.code == 2 and shown.out == "" and said in shown.err
    assert shown.err.startswith(f"mqslam: error: {dead}: ") and shown.err.count("\n") == 1, shown.err
    assert read_contents(dead.parent) == before


@pytest.mark.slow
def test_force_replaces_an_unfinished_run(lap: Path, dead: Path, whole: dict[str, bytes | None], tmp_path: Path) -> None:
    out = shutil.copytree(dead, tmp_path / "out")
    (out / CHECKPOINT / "measurements.npz").write_bytes(b"would be believed if it were not cleared")
    assert mqslam(*command(lap, out, "--force")).code == 0
    assert_as_whole(out, whole)
