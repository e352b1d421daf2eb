"""Verdicts on one recording under many trajectories, whose returns are detected once."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np
from bench.measuring.scorer import headings
from evo.core.trajectory import PoseTrajectory3D

from mqslam.auditing import judge
from mqslam.auditing.sources import place_source
from mqslam.commands.audit import detect_radar
from mqslam.commands.inputs import choose_settings, open_data
from mqslam.commands.work import Work
from mqslam.core import se2
from mqslam.core.trajectory import Trajectory
from mqslam.execution.local_engine import LocalEngine
from mqslam.psi.place import beam_of


def judge_tracks(data: Path, tracks: Mapping[str, PoseTrajectory3D]) -> Iterator[tuple[str, str]]:
    """Yields the name of every trajectory of a recording and the verdict on the map that it makes."""
    work = Work(LocalEngine(os.cpu_count() or 1))
    settings = choose_settings(None)
    source, _, settings = detect_radar(open_data(data, None, None, settings), None, "ground_truth", settings, work)
    beam = beam_of(settings.estimator, settings.sensor.doppler_beta or 0.0)
    for name, track in tracks.items():
        stamps = np.round(1e6 * track.timestamps).astype(np.int64)
        poses = np.column_stack([track.positions_xyz[:, :2], se2.wrap(headings(track))])
        sweeps, _ = place_source(source, Trajectory(stamps, poses), beam)
        judged = judge.audit(sweeps, settings.audit, settings.estimator, settings.verdict, work.engine, work.progress)
        yield name, str(judged.status)


def count_bad(verdicts: Sequence[str]) -> int:
    """Returns how many verdicts call a map bad."""
    return sum(verdict in ("warn", "fail") for verdict in verdicts)
