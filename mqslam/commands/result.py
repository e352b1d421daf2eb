"""The results that commands return: the folder that they have written, and the numbers in it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mqslam.auditing.verdict import VerdictStatus
from mqslam.core.trajectory import Trajectory
from mqslam.formats.trajectories import read_trajectory
from mqslam.results.files import name_evo_command


@dataclass(frozen=True)
class Result:
    """The result of a command.

    Args:
        folder: the folder with the result files, which the README lists.
        summary: the numbers, as `summary.json`, `audit.json` or `compare.json` holds them.
    """

    folder: Path
    summary: dict[str, Any]

    @property
    def report(self) -> Path:
        """The path of the report, a page for a browser."""
        return self.folder / "report.html"

    @property
    def warnings(self) -> list[str]:
        """The warnings that a reader should know before the numbers."""
        return list(self.summary["warnings"])


class JudgedResult(Result):
    """A result with a verdict on its map."""

    @property
    def verdict(self) -> VerdictStatus:
        """The verdict: `pass`, `warn`, `fail` or `not judged`."""
        return VerdictStatus(self.summary["verdict"]["status"])

    @property
    def reasons(self) -> list[str]:
        """The reasons of the verdict."""
        return list(self.summary["verdict"]["reasons"])


class TrajectoryResult(Result):
    """A result with a trajectory: the optimised one of a run, or the poses of a localisation in the frame of a map."""

    @property
    def evo_command(self) -> str:
        """The command by which evo computes the ATE of the report; empty where the recording has no ground truth."""
        return name_evo_command(self.folder)

    def read_trajectory(self) -> Trajectory:
        """Reads the trajectory.

        Raises:
            DataError: the file of the trajectory cannot be read.
        """
        return read_trajectory(self.folder / "trajectory.tum")


class RunResult(JudgedResult, TrajectoryResult):
    """The result of a run."""


class LocaliseResult(TrajectoryResult):
    """The result of a localisation."""


class MergeResult(Result):
    """The result of a merge."""

    def read_trajectories(self) -> list[Trajectory]:
        """Reads the trajectory of each recording, all of them in one frame.

        Raises:
            DataError: a file cannot be read.
        """
        count = len(self.summary["recordings"])
        return [read_trajectory(self.folder / f"trajectory_{n}.tum") for n in range(1, count + 1)]


@dataclass(frozen=True)
class CompareResult(Result):
    """The result of a comparison.

    Args:
        table: the numbers as text: a line of column heads, and a line per front end or trajectory.
        marked: (line, column) of the best values in the table; a column has several if they look the same there.
    """

    table: list[list[str]]
    marked: frozenset[tuple[int, int]]

    @property
    def conclusion(self) -> str:
        """The sentences that name the best row and say why; empty where there are fewer than two rows to compare."""
        best = self.summary["best"]
        return best["sentence"] if best else ""
