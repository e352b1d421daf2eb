"""Every command and snippet of the README and of the documentation is run as printed, in a folder that has what it names.

That takes minutes and is slow; that commands and options exist is seen at once.
"""

from __future__ import annotations

import gzip
import os
import re
import shlex
import shutil
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import gtsam
import numpy as np
import pytest
from support.commands import mqslam
from support.drives import street_drive
from support.sensors import gga, rmc, stamps, write_imu_csv, write_lines

import mqslam as mqslam_package
from mqslam.config import Config
from mqslam.core import se2
from mqslam.core.frontend import Context, load
from mqslam.errors import ConfigError
from mqslam.formats.trajectories import write_kitti
from mqslam.formats.tum import write_tum
from mqslam.simulator import simulate

ROOT = Path(__file__).parents[1]
README = (ROOT / "README.md").read_text(encoding="utf-8")
PAGES = sorted((ROOT / "docs").rglob("*.md"))
TEXT = "\n".join([README, *(page.read_text(encoding="utf-8") for page in PAGES)])
BINARY = ".venv/bin/mqslam "
WRITTEN = ("OUT", "RESULT.mcap", "RESULT.tum", "OUT.mcap", "figures", "drive", "results", "LOCALISED", "optimised.g2o")


def commands() -> list[str]:
    """Lists the lines of all pages that a user would type, without their comments."""
    typed = [line.split("  #")[0].strip() for line in TEXT.splitlines() if line.startswith("    ")]
    inline = [text for text in re.findall(r"`([^`\n]+)`", TEXT) if text.startswith(BINARY)]
    lines = dict.fromkeys([*typed, *inline])  # each once: the first screen shows some of those that follow
    return [line for line in lines if line.startswith((".venv/", "make "))]


def snippets(language: str) -> list[str]:
    """Lists the fenced blocks of a language."""
    return re.findall(rf"```{language}\n(.*?)```", TEXT, re.DOTALL)


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """A folder with everything that the README's commands name; it is the working directory meanwhile."""
    folder = tmp_path_factory.mktemp("readme")
    recording = simulate(folder / "DATA", scene="street", duration_s=4.0, movers=2, seed=3)
    truth = recording.ground_truth
    (folder / "demo").mkdir()
    (folder / "demo" / "drive").symlink_to(folder / "DATA")
    shutil.copy(folder / "DATA" / "odom.csv", folder / "wheels.csv")
    write_imu_csv(folder / "imu.csv", *(f"{t},0,0,0.1" for t in stamps(400, start_us=recording.start_us).tolist()))
    write_lines(folder / "log.nmea", rmc("122639.00", "130920"), *(gga(f"1226{second}.00") for second in range(40, 44)))
    (folder / "my_kiss.yaml").write_text("mapping:\n  voxel_size: 1.0\ndata:\n  max_range: 100.0\n")
    (folder / "mine.yaml").write_text("tracker: {sigma_alpha: 0.3}\n")
    (folder / "mine.py").write_text(next(text for text in snippets("python") if "class Mine" in text))
    (folder / "top_speed.py").write_text(next(text for text in snippets("python") if "TOP_SPEED" in text))
    for name in ("drive1", "drive2", "DATA2"):
        (folder / name).symlink_to(folder / "DATA")
    (folder / "runs.yaml").write_text(snippets("yaml")[0])
    for name in ("T.tum", "mine.tum"):
        write_tum(folder / name, truth)
    write_kitti(folder / "poses.txt", truth)
    (folder / "times.txt").write_text("".join(f"{t / 1e6:.6f}\n" for t in truth.stamps_us.tolist()))
    angles = np.deg2rad(np.arange(180) - 90.0)
    scans = []
    for k in range(40):
        x = 0.2 * k
        ahead, aside = (20.0 - x) / np.maximum(np.cos(angles), 1e-3), 3.0 / np.maximum(np.abs(np.sin(angles)), 1e-3)
        ranges = " ".join(f"{r:.2f}" for r in np.minimum(ahead, aside))
        scans.append(f"FLASER 180 {ranges} {x} 0 0 {x} 0 0 {10 + 0.5 * k} host {0.5 * k}\n")
    with gzip.open(folder / "scans.log.gz", "wt") as log:
        log.write("".join(scans))
    before = Path.cwd()
    os.chdir(folder)
    assert mqslam("run", "DATA", "--out", "finished", "--quiet").code == 0
    assert mqslam("audit", "DATA", "--trajectory", "T.tum", "--out", "EARLIER", "--quiet").code == 0
    for name in ("OUT1", "OUT2"):
        Path(name).symlink_to("finished")
    shutil.copy("finished/map.ply", "map.ply")
    shutil.copy("finished/trajectory.tum", "trajectory.tum")
    shutil.copy("finished/config.yaml", "config.yaml")
    shutil.copy("finished/graph.g2o", "graph.g2o")
    write_gtsam(Path("graph.txt"), Path("values.txt"))
    yield folder
    os.chdir(before)


def write_gtsam(graph: Path, values: Path) -> None:
    """Writes a graph of two poses as GTSAM does."""
    step = gtsam.BetweenFactorPose2(0, 1, gtsam.Pose2(1.0, 0.0, 0.0), gtsam.noiseModel.Isotropic.Sigma(3, 0.1))
    factors, known = gtsam.NonlinearFactorGraph(), gtsam.Values()
    factors.push_back(step)
    for key in step.keys():
        known.insert(key, gtsam.Pose2())
    graph.write_text(factors.serialize())
    values.write_text(known.serialize())


def prepare(words: list[str]) -> None:
    """Makes room for what a command writes, and copies a finished run to where it reads one."""
    for name in [word for word in words if word in WRITTEN]:
        if Path(name).is_dir():
            shutil.rmtree(name)
        Path(name).unlink(missing_ok=True)
    if words[1] == "OUT" or words[0] == "localise":
        shutil.copytree("finished", "OUT")


def words_of(line: str) -> list[str]:
    """Splits a command into words, without its name and without where its output goes."""
    words = shlex.split(line)[1:]
    return words[: words.index(">")] if ">" in words else words


@pytest.mark.parametrize("line", [line for line in commands() if line.startswith(BINARY)])
def test_a_command_and_its_options_exist(line: str) -> None:
    shown = mqslam(*words_of(line), "--help")  # all words are parsed before the help is shown
    assert shown.code == 0, shown.err


@pytest.mark.slow
@pytest.mark.parametrize("line", [line for line in commands() if line.startswith(BINARY)])
def test_a_command_works_as_printed(place: Path, line: str) -> None:
    words = words_of(line)
    prepare(words)
    if words[0] == "view" or "--live" in words:
        pytest.skip("needs a display or Rerun: tests/viewer runs it with both")
    if "--cluster" in words:
        pytest.skip("needs a cluster: tests/execution/test_cluster.py and tests/cli/test_batch.py start one for it")
    shown = mqslam(*words)
    if words[0] == "merge":  # of the same drive twice: tests/merging have others
        assert shown.code == 2 and "is given twice" in shown.err, shown.err
        return
    allowed = {0, 1} if words[0] in ("check", "batch") else {0, 1, 3} if "--fail-on" in words else {0}
    assert shown.code in allowed, shown.err


def test_what_is_typed_besides_is_known() -> None:
    others = {line.split(" #")[0].strip() for line in commands() if not line.startswith(BINARY)}
    assert others <= {"make demo", "make test", ".venv/bin/pip install --editable '.[view]'"}
    assert (ROOT / ".ci" / "run").read_text().rstrip().endswith("make test\nmake test-all\nmake docs\nmake dist")


def test_the_readme_is_read_in_minutes() -> None:
    assert len(README.splitlines()) <= 130


def test_every_link_leads_to_a_file_of_the_clone() -> None:
    for page in (*sorted(ROOT.glob("*.md")), *PAGES):
        links = re.findall(r"\]\(([^)#\s]+)", page.read_text(encoding="utf-8"))
        missing = [link for link in links if "://" not in link and not (page.parent / link).exists()]
        assert missing == [], page


def test_no_public_name_is_undocumented() -> None:
    text = (ROOT / "docs" / "reference" / "api.md").read_text(encoding="utf-8")
    named = {line.split(".")[-1] for line in text.splitlines() if line.startswith("::: ")}
    assert named >= {name for name in mqslam_package.__all__ if not name.startswith("__")}


@pytest.mark.slow
def test_make_demo_ends_with_a_report(tmp_path: Path) -> None:
    (tmp_path / "pyproject.toml").touch()
    os.utime(tmp_path / "pyproject.toml", (0, 0))  # older than the environment, which is there already
    environment = Path(sys.executable).parents[1]
    (environment / ".installed").touch()
    command = ["make", "--file", str(ROOT / "Makefile"), "--directory", str(tmp_path), f"VENV={environment}", "demo"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=1800, check=True)
    assert "open demo/run/report.html" in done.stdout
    assert (tmp_path / "demo" / "run" / "report.html").stat().st_size < 5_000_000


def programs() -> list[str]:
    """Lists the programs in Python: a run, and a graph of one's own."""
    return list(dict.fromkeys(text for text in snippets("python") if "import mqslam\n" in text))


@pytest.mark.slow
def test_the_program_in_python_runs_as_printed(place: Path) -> None:
    program = next(text for text in programs() if "mqslam.run" in text)
    assert len(program.strip().splitlines()) == 5
    done = subprocess.run([sys.executable, "-c", program], cwd=place, capture_output=True, text=True, timeout=1800)
    assert done.returncode == 0, done.stderr
    assert (place / "demo" / "again" / "trajectory.tum").is_file() and done.stdout


@pytest.mark.slow
def test_the_graph_of_ones_own_is_built_as_printed(place: Path) -> None:
    page = (ROOT / "docs" / "tutorials" / "own-graph.md").read_text(encoding="utf-8")
    program = "".join(re.findall(r"```python\n(.*?)```", page, re.DOTALL))
    done = subprocess.run([sys.executable, "-c", program], cwd=place, capture_output=True, text=True, timeout=1800)
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("0 ")  # the street of the test is driven once
    assert mqslam("optimise", "graph.txt", "--values", "values.txt").code == 0


def test_the_front_end_of_ones_own_is_one(tmp_path: Path) -> None:
    (source,) = [text for text in snippets("python") if "class Mine" in text]
    names: dict[str, Any] = {}
    exec(source, names)
    recording, scans = street_drive()
    context = Context(Config(), recording.revolution_s, recording.start_us, None)
    motions = list(names["Mine"](context).measure(scans))
    assert len(motions) == len(scans) - 1
    np.testing.assert_allclose(se2.chain(m.pose for m in motions)[-1], [2.0 * len(motions), 0.0, 0.0])
    (tmp_path / "mine.py").write_text(source)
    assert load(str(tmp_path / "mine.py")).__name__ == "Mine"
    with pytest.raises(ConfigError, match="defines 0 classes with a method measure; define one"):
        (tmp_path / "none.py").write_text("")
        load(str(tmp_path / "none.py"))
    with pytest.raises(ConfigError, match=r"cannot be imported \(.*No module named 'nowhere'"):
        (tmp_path / "broken.py").write_text("import nowhere")
        load(str(tmp_path / "broken.py"))
    (entry,) = snippets("toml")
    project = {"name": "my_package", "version": "0.1", "entry-points": {"mqslam.frontends": {"mine": "my_package:Mine"}}}
    assert tomllib.loads(entry) == {"project": project}


def test_files_it_names_are_there() -> None:
    for name in re.findall(r"\]\(([^)#]+)\)", README):
        assert name.startswith("http") or (ROOT / name).exists(), name
    for name in re.findall(r"`((?:tests|notebooks|mqslam|configs|frontends|factors)/[\w/.-]*)`", TEXT):
        assert (ROOT / name).exists(), name


def test_the_table_of_parts_is_the_tree() -> None:
    table = TEXT.split("\n| part | holds |\n")[1].split("\n\n")[0]
    named = {name.rstrip("/") for line in table.splitlines() for name in re.findall(r"`([^`]+)`", line.split("|")[1])}
    parts = {path for path in (ROOT / "mqslam").iterdir() if path.suffix == ".py" or (path / "__init__.py").is_file()}
    inside = {f"mqslam/{path.name}" for path in parts if path.name != "__init__.py"}
    assert named == inside | {"frontends", "factors", "configs", "notebooks", "tests"}


def examples() -> list[str]:
    """Lists the examples in the help of the commands, but for those that the README has."""
    lines = [
        line.split("Example: ")[1].strip()
        for file in sorted((ROOT / "mqslam" / "cli").rglob("*.py"))
        for line in file.read_text(encoding="utf-8").splitlines()
        if "Example: mqslam " in line
    ]
    return sorted({line for line in lines if line.replace("mqslam ", BINARY, 1) not in commands()})


@pytest.mark.parametrize("line", examples())
def test_an_example_of_the_help_and_its_options_exist(line: str) -> None:
    shown = mqslam(*words_of(line), "--help")
    assert shown.code == 0, shown.err


@pytest.mark.slow
@pytest.mark.parametrize("line", examples())
def test_an_example_of_the_help_works_as_printed(
    place: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, line: str
) -> None:
    words = words_of(line)
    monkeypatch.chdir(tmp_path)
    if words[0] != "simulate":  # that one writes the drive itself
        Path("drive").symlink_to(place / "DATA")
    if words[-2:] != ["--out", "result"]:
        Path("result").symlink_to(place / "finished")
    if words[0] == "merge":
        pytest.skip("needs the results of two drives: tests/merging has them")
    if words[0] == "diff":
        Path("earlier").symlink_to(place / "finished")
    if words[0] == "localise":
        Path("second_drive").symlink_to(place / "DATA")
    if "drive.bag" in words:
        assert mqslam("convert", "drive", "drive.bag", "--quiet").code == 0
    if words[0] == "view":
        pytest.skip("needs a display: tests/viewer runs it with one")
    shown = mqslam(*words)
    assert shown.code in {"audit": {0, 1, 3}, "check": {0, 1}}.get(words[0], {0}), shown.err
