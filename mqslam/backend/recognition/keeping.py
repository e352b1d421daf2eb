"""What a run keeps of its map, so that the map can be used without the recording."""

from __future__ import annotations

from mqslam.backend.linear.marginals import PoseCovariances
from mqslam.backend.loops.submap import MappedDrive
from mqslam.backend.recognition.places import describe_places
from mqslam.core.engine import Engine
from mqslam.core.keyframes import KeyframeMap, MappedRecording
from mqslam.core.scans import Scans
from mqslam.core.trajectory import Trajectory
from mqslam.mapping.keyframing import make_keyframes
from mqslam.psi.place import Beam


def keep_map(
    scans: Scans,
    track: Trajectory,
    sure: PoseCovariances,
    source: MappedRecording,
    beam: Beam,
    engine: Engine,
) -> KeyframeMap:
    """Returns the keyframes of a map, and its places as they look.

    Args:
        scans: of the recording.
        track: the pose of each scan.
        sure: how sure these poses are.
        source: what the recording is.
        beam: the sensor's errors.
        engine: where places are described; the result does not depend on it.
    """
    covariances = sure.covariances if sure.failure is None and len(sure.indices) == len(track) else None
    keyframes = make_keyframes(scans, track.poses, covariances, source, beam)
    places = describe_places(MappedDrive.of(keyframes), beam, engine)
    return KeyframeMap(keyframes, places)
