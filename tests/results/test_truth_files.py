"""evo, asked as the terminal says, computes the ATE of the report."""

from __future__ import annotations

import os
import re
import shlex
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from mqslam.core import se2
from mqslam.core.trajectory import Trajectory
from mqslam.evaluation import evaluate
from mqslam.formats.tum import read_tum, write_tum
from mqslam.results.files import name_evo_command, write_truth

START_US = 1_560_000_000_000_000


def chain_drive(noise: float, step_us: int = 250_000) -> Trajectory:
    """A winding drive of a minute at 8 m/s whose motions err by so much [m] from one pose to the next."""
    stamps = START_US + np.arange(0, 60_000_000, step_us)
    dt = step_us * 1e-6
    rng = np.random.default_rng(3)
    rates = 0.3 * np.sin(0.2 * dt * np.arange(len(stamps) - 1))
    moves = se2.exp(np.column_stack([np.full(len(rates), 8.0 * dt), np.zeros(len(rates)), rates * dt]))
    moves[:, :2] += rng.normal(0.0, noise, (len(moves), 2)) if noise else 0.0
    return Trajectory(stamps, se2.chain(moves))


def ask_evo(command: str, home: Path) -> float:
    """Returns the root mean square error [m] that evo prints."""
    tool = Path(sys.executable).with_name("evo_ape")
    if not tool.is_file():
        pytest.skip("evo is not installed")
    name, *words = shlex.split(command)
    assert Path(name).name == "evo_ape"
    shown = subprocess.run([tool, *words], capture_output=True, text=True, env={**os.environ, "HOME": str(home)})
    assert shown.returncode == 0, shown.stderr
    found = re.search(r"rmse\s+([\d.]+)", shown.stdout)
    assert found is not None, shown.stdout
    return float(found[1])


@pytest.mark.parametrize("step_us", [250_000, 100_000, 1_000_000], ids=["stamps of scans", "oftener", "seldom"])
def test_evo_gives_the_reported_error_to_six_digits(tmp_path: Path, step_us: int) -> None:
    estimate, truth = chain_drive(0.02), chain_drive(0.0, step_us)
    folder = tmp_path / "a folder"
    folder.mkdir()
    write_tum(folder / "trajectory.tum", estimate)
    write_truth(folder, estimate, truth)
    errors = evaluate(estimate, truth)
    assert errors is not None and errors.ate_rmse_m > 0.05
    assert ask_evo(name_evo_command(folder), tmp_path) == pytest.approx(errors.ate_rmse_m, abs=1.5e-6)


def test_evo_is_named_by_its_path_where_a_shell_would_not_find_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "ground_truth.tum").touch()
    (tmp_path / "bin").mkdir()
    tool = tmp_path / "bin" / "evo_ape"
    monkeypatch.setattr(sys, "executable", str(tmp_path / "bin" / "python"))
    monkeypatch.setenv("PATH", str(tmp_path))
    assert name_evo_command(tmp_path).startswith("evo_ape tum ")
    tool.touch(mode=0o755)
    assert name_evo_command(tmp_path).startswith(f"{tool} tum ")
    monkeypatch.setenv("PATH", str(tool.parent))
    assert name_evo_command(tmp_path).startswith("evo_ape tum ")


def test_the_trajectory_is_not_written_twice_where_its_stamps_are_those_of_the_truth(tmp_path: Path) -> None:
    estimate = chain_drive(0.02)
    truth = Trajectory(estimate.stamps_us[3:-5:2], estimate.poses[3:-5:2])
    write_truth(tmp_path, estimate, truth)
    assert [path.name for path in tmp_path.iterdir()] == ["ground_truth.tum"]
    np.testing.assert_array_equal(read_tum(tmp_path / "ground_truth.tum").stamps_us, truth.stamps_us)


def test_without_truth_there_is_no_file_and_no_command(tmp_path: Path) -> None:
    estimate = chain_drive(0.02)
    write_truth(tmp_path, estimate, None)
    write_truth(tmp_path, estimate, Trajectory(estimate.stamps_us[:2], estimate.poses[:2]))
    assert list(tmp_path.iterdir()) == [] and name_evo_command(tmp_path) == ""
