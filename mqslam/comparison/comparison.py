"""A finished comparison."""

from __future__ import annotations

from dataclasses import dataclass

from mqslam.comparison.best import Best
from mqslam.comparison.judgement import JudgedRow, Place
from mqslam.comparison.rows import Row
from mqslam.config import Config
from mqslam.core.recording import Recording
from mqslam.evaluation import Evaluation


@dataclass(frozen=True, slots=True)
class Comparison:
    """Everything a finished comparison knows.

    Args:
        recording: the recording.
        settings: all settings.
        doppler_beta: range shift per closing speed by which the rows were rendered [s].
        rows: front ends and given trajectories, those that failed too.
        judged: the rows that ran, judged, by their names.
        best: the best of them, or those that cannot be told apart; None without two rows to compare.
        psi_across: psi per point across passes by row; empty where no place is passed twice.
        compared: number of scans that every row covers, on which they are judged.
        places: places where the rows differ most; the rows' crops begin with these.
        stations: places all along the path, whose crops follow.
        agreement: names of every two rows that ran, and how far they are apart.
        warnings: what the reader has to know before the numbers.
    """

    recording: Recording
    settings: Config
    doppler_beta: float
    rows: tuple[Row, ...]
    judged: dict[str, JudgedRow]
    best: Best | None
    psi_across: dict[str, float]
    compared: int
    places: tuple[Place, ...]
    stations: tuple[Place, ...]
    agreement: tuple[tuple[str, str, Evaluation], ...]
    warnings: tuple[str, ...]
