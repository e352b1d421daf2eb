"""Ground truth beside a run's trajectory, in files that evo compares to the numbers of the report."""

from __future__ import annotations

import shutil
import sys
from pathlib import Path
from shlex import quote
from typing import Final

import numpy as np

from mqslam.core.trajectory import Trajectory
from mqslam.evaluation import pair_poses
from mqslam.formats.tum import write_tum

TRUTH: Final = "ground_truth.tum"
AT_TRUTH: Final = "trajectory_at_truth.tum"
_EVO: Final = "evo_ape"


def write_truth(folder: Path, estimate: Trajectory, truth: Trajectory | None) -> None:
    """Writes the poses of the ground truth that a run is evaluated at, in the frame of its trajectory.

    evo pairs poses by their stamps. Where the truth has other stamps than the scans, the trajectory is written again,
    interpolated at the stamps of the truth as the evaluation does it.

    Args:
        folder: of the results.
        estimate: the optimised trajectory.
        truth: ground truth, or None; nothing is written where the two share fewer than 3 stamps.

    Raises:
        OutputError: a file cannot be written.
    """
    pair = None if truth is None else pair_poses(estimate, truth)
    if pair is None:
        return
    estimated, true = pair
    write_tum(folder / TRUTH, true)
    if not np.isin(true.stamps_us, estimate.stamps_us).all():
        write_tum(folder / AT_TRUTH, estimated)


def name_evo_command(folder: Path) -> str:
    """Returns the command by which evo computes the ATE of the report; empty where a run had no ground truth.

    Where a shell would not find evo, but it is installed beside the Python that runs this, its whole path is named.
    """
    if not (folder / TRUTH).is_file():
        return ""
    estimate = AT_TRUTH if (folder / AT_TRUTH).is_file() else "trajectory.tum"
    beside = Path(sys.executable).with_name(_EVO)
    tool = str(beside) if shutil.which(_EVO) is None and beside.is_file() else _EVO
    return f"{quote(tool)} tum {quote(str(folder / TRUTH))} {quote(str(folder / estimate))} -a"
