"""The commands on damaged recordings and results: an exit code and a line, never a traceback, in time and in bounded memory.

`MQSLAM_FUZZ=300 MQSLAM_FUZZ_NEW=1 pytest tests/fuzz` calls each command so many times on inputs that are drawn anew.
"""

from __future__ import annotations

import gc
import itertools
import shutil
from pathlib import Path

import pytest
from support.commands import mqslam, run_in_this_process
from support.fuzzing import INPUTS, Outcome, fuzz
from support.limits import within_limits
from support.mutation import Mutate, inside_png, plain

from mqslam.simulator import SensorModel, simulate

QUICK = "sensor: {doppler_beta: 0.0}\ndetector: {threshold: 3.0}\n"
PAGED = 16  # one in so many calls makes its pages, which takes longer than all the rest
PAGES = [
    "mqslam.commands.run.write_run_page",
    "mqslam.commands.audit.write_audit_page",
    "mqslam.commands.compare.write_compare_page",
    "mqslam.commands.localise.write_localise_page",
    "mqslam.commands.merge.write_merge_page",
]
SELDOM = {"audit of a cloud": 4, "audit of a trajectory": 4}  # other ways of calling a command get one in so many inputs
COMMANDS = {  # what is damaged, and the words of the command
    "run": ("drive", "run drive --out out --config quick.yaml --jobs 1"),
    "audit": ("drive", "audit drive --trajectory ground_truth --out out --config quick.yaml --jobs 1"),
    "audit of a cloud": ("map.ply", "audit map.ply --out out --config quick.yaml --jobs 1"),
    "audit of a trajectory": ("given.tum", "audit drive --trajectory given.tum --out out --config quick.yaml --jobs 1"),
    "compare": ("drive", "compare drive --frontends odometry --odometry-only --out out --config quick.yaml --jobs 1"),
    "localise": ("result", "localise drive --map result --out out --jobs 1"),
    "merge": ("result", "merge result other --out out --config quick.yaml --jobs 1"),
    "check": ("drive", "check drive --config quick.yaml"),
    "info": ("drive", "info drive"),
    "convert": ("drive", "convert drive out.mcap"),
    "convert of a result": ("result", "convert result out.mcap"),
    "optimise": ("result", "optimise result/graph.g2o --out out.g2o"),
}


@pytest.fixture(scope="module")
def base(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two short coarse drives through the same street with all sensors, and their results."""
    folder = tmp_path_factory.mktemp("base")
    sensor = SensorModel(turn_rate_hz=2.5, azimuths=60, range_resolution=0.35, max_range=50.0)
    (folder / "quick.yaml").write_text(QUICK)
    for name, result in (("drive", "result"), ("second", "other")):
        simulate(folder / name, duration_s=4.0, sensor=sensor, movers=0)
        words = ("--config", folder / "quick.yaml", "--jobs", 1, "--quiet")
        assert mqslam("run", folder / name, "--out", folder / result, *words).code == 0
    shutil.copy(folder / "result" / "map.ply", folder / "map.ply")
    shutil.copy(folder / "result" / "ground_truth.tum", folder / "given.tum")
    return folder


@pytest.mark.slow
@pytest.mark.parametrize("name", COMMANDS)
@pytest.mark.filterwarnings("ignore")
def test_a_command_ends_with_a_code_and_a_line(
    base: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    monkeypatch.setattr("mqslam.merging.sessions._FEWEST", 2)  # the drives are too short for more
    place = shutil.copytree(base, tmp_path / "place")
    monkeypatch.chdir(place)
    calls = itertools.count()

    def act(size: int) -> Outcome:
        with monkeypatch.context() as patch:
            for pages in PAGES if next(calls) % PAGED else ():
                patch.setattr(pages, lambda *_: [])
            return call(name, size, names)

    names = {path.name for path in place.iterdir()}
    assert not act(0).refused
    fuzz(name, place / COMMANDS[name][0], mutations, act, -(-INPUTS // SELDOM.get(name, 1)))


def call(name: str, size: int, names: set[str]) -> Outcome:
    """Calls a command in the working folder, which holds nothing but some names before and afterwards."""
    gc.collect(0)
    quiet = () if name in ("info", "check") else ("--quiet",)
    with within_limits(size, always_mb=650.0, seconds=20.0) as cost, run_in_this_process():
        shown = mqslam(*COMMANDS[name][1].split(), *quiet)
    for out in (Path("out"), Path("out.mcap"), Path("out.g2o")):
        shutil.rmtree(out) if out.is_dir() else out.unlink(missing_ok=True)
    last = (shown.err.splitlines() or [""])[-1]
    assert shown.code in (0, 1, 2, 3), shown.err
    assert "Traceback" not in shown.err and len(last) < 1200
    assert (shown.code == 2) == last.startswith("mqslam: error: "), (shown.code, shown.err)
    assert {path.name for path in Path().iterdir()} == names
    return Outcome(shown.code == 2, cost)


def mutations(file: Path) -> tuple[Mutate, ...]:
    """Returns the kinds of damage to a file."""
    return (plain, inside_png) if file.suffix == ".png" else (plain,)
