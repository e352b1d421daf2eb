"""Small maps of keyframes, made from simulated drives or by hand."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from support.drives import block_drive

from mqslam.config import Config
from mqslam.core import se2
from mqslam.core.keyframes import KEYFRAME_POINT, KeyframeMap, Keyframes, MappedRecording, PlaceTable
from mqslam.core.scans import Scans
from mqslam.core.sensors import Georeference, TangentPlane
from mqslam.mapping.keyframing import make_keyframes
from mqslam.psi.place import beam_of

CONFIG = Config()
BEAM = beam_of(CONFIG.estimator, 0.0)


@lru_cache(maxsize=1)
def lap() -> tuple[Scans, se2.Array, Keyframes]:
    """Returns the scans of a bit more than a round of a block, their true poses, and keyframes of them 2.5 m apart."""
    recording, scans = block_drive()
    assert recording.ground_truth is not None
    poses = recording.ground_truth.at(scans.stamps_us)
    source = MappedRecording("lap", recording.start_us, recording.end_us, recording.revolution_s, 0.0)
    return scans, poses, make_keyframes(scans, poses, None, source, BEAM)


def two_recordings() -> KeyframeMap:
    """Returns five keyframes of two recordings with a few points each, of which the last has none."""
    rng = np.random.default_rng(3)
    points = np.zeros(12, KEYFRAME_POINT)
    for name in ("x", "y", "range", "ray", "time", "intensity"):
        points[name] = rng.uniform(0.0, 0.2 if name == "time" else 9.0, 12)
    ends = np.array([0, 3, 6, 9, 12, 12])
    covariances = np.array([np.diag(rng.uniform(0.1, 1.0, 3)) for _ in range(5)])
    covariances[3] = np.nan
    first, second = 1_000_000_000, 5_000_000_000
    keyframes = Keyframes(
        recordings=(
            MappedRecording("a", first, first + 3_000_000, 0.25, 0.048),
            MappedRecording("b", second, second + 2_000_000, 0.25, 0.0),
        ),
        origins=np.array([0, 0, 0, 1, 1]),
        scans=np.array([0, 4, 8, 0, 5]),
        stamps_us=np.array([first, first + 1_000_000, first + 2_000_000, second, second + 1_250_000]),
        poses=rng.uniform(-3.0, 3.0, (5, 3)),
        covariances=covariances,
        travelled=np.array([0.0, 3.0, 6.0, 0.0, 4.0]),
        rows=np.column_stack([ends[:-1], ends[1:]]),
        points=points,
        georeference=Georeference(TangentPlane(49.0, 8.4), np.array([10.0, -5.0, 0.3])),
    )
    descriptors = rng.uniform(0.0, 1.0, (2, 4, 6)).astype(np.float16)
    return KeyframeMap(keyframes, PlaceTable(np.array([0, 3]), descriptors, {"rings": 4, "sectors": 6}))
