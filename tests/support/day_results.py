"""Results of short simulated drives, as a run would leave them but for its front end: poses are the truth with drift."""

from __future__ import annotations

from pathlib import Path

import gtsam
import numpy as np
from numpy.typing import NDArray
from support.drives import detected

from mqslam.backend.loops.passes import MappedDrive
from mqslam.backend.loops.recognition import describe_places
from mqslam.config import Config, SensorConfig, dump_yaml
from mqslam.core import se2
from mqslam.core.keyframes import KeyframeMap, MappedRecording
from mqslam.core.trajectory import Trajectory
from mqslam.execution.local_engine import HERE
from mqslam.formats.graphs.g2o import format_poses_and_edges
from mqslam.formats.maps.keyframe_folder import FOLDER, write_keyframes
from mqslam.formats.tum import write_tum
from mqslam.mapping.keyframing import make_keyframes
from mqslam.psi.place import beam_of
from mqslam.simulator import Scene, SensorModel, make_loop_drive, simulate_recording
from mqslam.simulator.drive import SampledDrive

CONFIG = Config(sensor=SensorConfig(doppler_beta=0.0))
DRIFT = np.array([0.01, 0.01, 0.0004])  # standard deviations of each motion's error [m, m, rad]


def drive_from(start_s: float, duration_s: float) -> SampledDrive:
    """Returns a piece of the round of a street scene's middle block."""
    lap = make_loop_drive(start_s + duration_s)
    return SampledDrive(lap.times - start_s, lap.samples, lap.rates)


def write_day(
    folder: Path, scene: Scene, start_s: float, duration_s: float, seed: int, frame: se2.Array | None = None
) -> NDArray[np.float64]:
    """Writes the result of a drive, and returns the true poses (N, 3) of its scans in the scene.

    Args:
        folder: of the result.
        scene: what reflects.
        start_s: where on the round of the block the drive starts [s].
        duration_s: of the drive [s].
        seed: of all noise, and of the drift.
        frame: (3,) pose of the first scan in the frame of the result; the origin by default.
    """
    sensor = SensorModel(azimuths=200, range_resolution=0.175, max_range=80.0)
    motion = drive_from(start_s, duration_s)
    recording = simulate_recording(scene, motion, duration_s=duration_s, sensor=sensor, seed=seed)
    assert recording.ground_truth is not None
    truth, scans = recording.ground_truth.poses, detected(recording)
    rng = np.random.default_rng(seed)
    motions = se2.between(truth[:-1], truth[1:])
    motions = motions + rng.normal(0.0, 1.0, motions.shape) * DRIFT
    poses = se2.chain(motions, np.zeros(3) if frame is None else np.asarray(frame, dtype=np.float64))
    factors, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    for k, pose in enumerate(poses):
        values.insert(k, gtsam.Pose2(*pose))
    noise = gtsam.noiseModel.Diagonal.Sigmas(DRIFT)
    for k, motion_between in enumerate(motions):
        factors.push_back(gtsam.BetweenFactorPose2(k, k + 1, gtsam.Pose2(*motion_between), noise))
    beam = beam_of(CONFIG.estimator, 0.0)
    source = MappedRecording(f"{folder.name}.drive", recording.start_us, recording.end_us, recording.revolution_s, 0.0)
    keyframes = make_keyframes(scans, poses, None, source, beam)
    places = describe_places(MappedDrive.of(keyframes), beam, HERE)
    folder.mkdir(parents=True)
    write_keyframes(folder / FOLDER, KeyframeMap(keyframes, places))
    (folder / "graph.g2o").write_text(format_poses_and_edges(factors, values, list(range(len(poses)))))
    write_tum(folder / "trajectory.tum", Trajectory(scans.stamps_us, poses))
    (folder / "config.yaml").write_text(dump_yaml(CONFIG))
    return truth
