"""Verdicts on one recording under many trajectories, whose returns are detected once."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from pathlib import Path

import numpy as np
from bench.measuring.scorer import headings
from evo.core.trajectory import PoseTrajectory3D

from mqslam.auditing import judge
from mqslam.auditing.sources import Source, place_source
from mqslam.commands.opening import choose_settings, open_data
from mqslam.config import set_doppler_beta
from mqslam.core import se2
from mqslam.core.trajectory import Trajectory
from mqslam.detection.stage import detect_all
from mqslam.execution.engine import LocalEngine
from mqslam.execution.progress import ignore_progress
from mqslam.execution.runner import Runner
from mqslam.psi.doppler import choose_doppler_beta
from mqslam.psi.place import beam_of


def judge_tracks(data: Path, tracks: Mapping[str, PoseTrajectory3D]) -> Iterator[tuple[str, str]]:
    """Yields the name of every trajectory of a recording and the verdict on the map that it makes."""
    settings = choose_settings(None)
    engine = LocalEngine(os.cpu_count() or 1)
    recording = open_data(data, None, None, settings)
    scans, _ = detect_all(recording, settings.detector, Runner(engine))
    beta = choose_doppler_beta(scans, settings.sensor, settings.tracker, settings.estimator)
    settings = set_doppler_beta(settings, beta)
    source = Source(recording.path, recording.format, scans, {}, ())
    for name, track in tracks.items():
        stamps = np.round(1e6 * track.timestamps).astype(np.int64)
        poses = np.column_stack([track.positions_xyz[:, :2], se2.wrap(headings(track))])
        sweeps, _ = place_source(source, Trajectory(stamps, poses), settings.audit, beam_of(settings.estimator, beta))
        judged = judge.audit(sweeps, settings.audit, settings.estimator, settings.verdict, engine, ignore_progress)
        yield name, str(judged.status)
