"""How well a recording is localised in the map of another one, and how soon from a cold start."""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np
from bench.benchmark import Cell
from bench.measuring.commands import localise, read_json
from bench.measuring.recordings import TRUTH
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from mqslam.backend.loops.recognition import PLACE_SPACING_M, ROW
from mqslam.backend.measuring import measure
from mqslam.config import load_config
from mqslam.core import se2
from mqslam.core.frontend import Context
from mqslam.core.keyframes import KeyframeMap
from mqslam.core.scans import Scans
from mqslam.detection.stage import detect_all
from mqslam.errors import NotInMapError
from mqslam.execution.runner import Runner
from mqslam.formats.covariances import read_covariances
from mqslam.formats.maps.keyframe_folder import read_keyframes
from mqslam.formats.recordings import open_recording
from mqslam.formats.tum import read_tum
from mqslam.localisation.localise import localise as find_in_map
from mqslam.psi.place import beam_of

NEAR_M, NEAR_DEG = 0.3, 0.5
_STARTS = 40  # cold starts, spread over the recording
_AHEAD = 120  # scans of each, half a minute


def measure_localised(data: Path, mapped: Path, result: Path, out: Path) -> dict[str, Cell]:
    """Returns how well a recording is localised, by the command on one job, against the truths of both recordings.

    A pose is judged against the nearest keyframe of the map, by the true pose of one in the frame of the other: how far the
    map itself is bent over kilometres is not what localisation answers for.

    Args:
        data: the recording.
        mapped: the recording that the map was made from.
        result: the run that keeps the map.
        out: folder for the results.
    """
    folder = localise(data, result, out, "--odometry", "none", "--imu", "none", "--jobs", "1")
    summary = read_json(folder / "summary.json")
    track, given = read_tum(folder / "trajectory.tum"), read_covariances(folder / "covariances.csv")
    rows = (folder / "poses.csv").read_text(encoding="utf-8").splitlines()[1:]
    on_map = np.array([row.split(",")[7] in ("converged", "degenerate") for row in rows])
    made, truth = read_keyframes(result), read_tum(data / TRUTH).at(track.stamps_us)
    off, away = compare_with_map(track.poses, truth, made, read_tum(mapped / TRUTH).at(made.keyframes.stamps_us))
    own = np.array([se2.rotate_covariance(c, -y) for c, y in zip(given.covariances, track.poses[:, 2], strict=True)])
    distances, turns = np.hypot(off[:, 0], off[:, 1]), np.degrees(np.abs(off[:, 2]))
    near = on_map & (distances < NEAR_M) & (turns < NEAR_DEG)
    within = away < 5.0
    took = summary["runtime_s"]["total"]
    return {
        "near": float(near[within].mean()),
        "wrong": float((on_map & ~near).sum()),
        "outside": float(on_map[away > 20.0].sum()),
        "error_m": float(np.percentile(distances[on_map], 95)),
        "error_deg": float(np.percentile(turns[on_map], 95)),
        "nees": float(se2.normalise(off[on_map], own[on_map]).mean() / 3.0),
        "real_time": summary["dataset"]["duration_s"] / took,
        "peak_mb": summary["peak_rss_mb"],
    }


def compare_with_map(
    poses: se2.Array, truth: se2.Array, made: KeyframeMap, true_keyframes: se2.Array
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Returns by how much (N, 3) poses in a map are off in their own frames, and how far (N,) the map truly is from them.

    Args:
        poses: (N, 3) in the map's frame.
        truth: (N, 3) true ones.
        made: the map.
        true_keyframes: (K, 3) true poses of its keyframes, in the frame of the truth.
    """
    nearest = cKDTree(made.keyframes.poses[:, :2]).query(poses[:, :2])[1]
    expected = se2.between(true_keyframes[nearest], truth)
    off = se2.wrapped_between(expected, se2.between(made.keyframes.poses[nearest], poses))
    return off, np.asarray(cKDTree(true_keyframes[:, :2]).query(truth[:, :2])[0])


def measure_cold_starts(data: Path, mapped: Path, result: Path) -> dict[str, Cell]:
    """Returns how often and how soon a recording is found that begins at any of its scans that the map has a place for.

    Each start has half a minute of the recording. The seconds are processor time for motions and places, without detection.
    """
    made, config = read_keyframes(result), load_config(result / "config.yaml")
    recording, beam = open_recording(data), beam_of(config.estimator, config.sensor.doppler_beta or 0.0)
    scans, _ = detect_all(recording, config.detector)
    truth = read_tum(data / TRUTH).at(scans.stamps_us)
    true_keyframes = read_tum(mapped / TRUTH).at(made.keyframes.stamps_us)
    tree = cKDTree(true_keyframes[:, :2])
    found, wrong, tried, seconds = 0, 0, 0, list[float]()
    for k in np.linspace(0, len(scans) - _AHEAD, _STARTS).astype(int).tolist():
        part, true = _cut(scans, k), truth[k : k + _AHEAD]
        moves = se2.path_lengths(true)[-1] > (ROW + 1) * PLACE_SPACING_M
        if not moves or tree.query(true[:, :2])[0].max() > 5.0:
            continue
        tried += 1
        begin = time.process_time()
        context = Context(config, scans.revolution_s, scans.start_us, None, doppler_beta=beam.doppler_beta)
        motions = measure("psi", part, context, beam, Runner())
        try:
            localised = find_in_map(part, motions, made, config.estimator, beam, Runner())
        except NotInMapError:
            continue
        seconds.append(time.process_time() - begin)
        off, _ = compare_with_map(localised.poses, true, made, true_keyframes)
        found += 1
        wrong += int((np.hypot(off[:, 0], off[:, 1])[localised.on_map] > NEAR_M).any())
    return {
        "starts": float(tried),
        "found": found / max(tried, 1),
        "wrong_starts": float(wrong),
        "start_s": float(np.max(seconds, initial=0.0)),
    }


def _cut(scans: Scans, begin: int) -> Scans:
    """Returns half a minute of scans."""
    return scans[begin : begin + _AHEAD]
