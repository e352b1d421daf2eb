"""Scans followed through the map: each is predicted by the motion from its neighbour, and laid into the map by psi."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mqslam.backend.loops.submap import TrackedRun
from mqslam.config import EstimatorConfig
from mqslam.core import se2
from mqslam.core.keyframes import Keyframes
from mqslam.core.measurement import Measurement
from mqslam.execution.progress import Progress, ignore_progress
from mqslam.localisation.localised import ON_MAP, PlaceStatus
from mqslam.localisation.registering import MapAround, Prediction, Registered, is_away, register
from mqslam.psi.place import Beam, PointSet

# Path [m] without a scan that lies on the map, after which scans are no longer followed from there. The recording is then
# looked up again beyond it.
_GIVE_UP_M = 30.0


@dataclass(frozen=True, slots=True)
class Setting:
    """What scans are followed with.

    Args:
        drive: the scans under their chained motions.
        motions: N - 1 motions between N successive scans.
        keyframes: of the map.
        estimator: settings of the score.
        beam: the sensor's errors.
    """

    drive: TrackedRun
    motions: Sequence[Measurement]
    keyframes: Keyframes
    estimator: EstimatorConfig
    beam: Beam

    def render(self, k: int) -> PointSet:
        """Returns the returns of scan k in the frame of its start."""
        return self.drive.render(k, np.array([k]), self.beam)

    def predict(self, known: Prediction, k: int, n: int) -> Prediction:
        """Returns where scan n is expected, which follows or precedes scan k, of which it is known where it lies."""
        motion = self.motions[min(k, n)]
        if n > k:
            step, covariance = motion.pose, motion.covariance
        else:
            step = se2.inverse(motion.pose)
            covariance = se2.covariance_of_inverse(motion.pose, motion.covariance)
        back = se2.adjoint(se2.inverse(step))
        grown = se2.rotate_covariance(covariance, -float(step[2])) + back @ known.covariance @ back.T
        return Prediction(se2.compose(known.pose, step), grown)


class LocalisedScans:
    """Where each scan of a recording lies in the map, as far as it is known.

    Args:
        count: number of scans.
        progress: called as scans are compared with the map.

    Attributes:
        poses, covariances, psi, matched, statuses: as in `Localised`.
        tried: (N,) whether the scan was compared with the map.
        on_map: (N,) whether it lies on the map.
    """

    def __init__(self, count: int, progress: Progress = ignore_progress) -> None:
        self._progress = progress
        self.poses = np.full((count, 3), np.nan)
        self.covariances = np.full((count, 3, 3), np.nan)
        self.psi, self.matched = np.full(count, np.nan), np.full(count, np.nan)
        self.tried, self.on_map = np.zeros(count, dtype=np.bool_), np.zeros(count, dtype=np.bool_)
        self.statuses = [PlaceStatus.LOST] * count

    def get(self, k: int) -> Prediction:
        """Returns where scan k lies."""
        return Prediction(self.poses[k], self.covariances[k])

    def put(self, k: int, registered: Registered) -> None:
        """Puts in where scan k lies."""
        self.poses[k], self.covariances[k] = registered.pose, registered.covariance
        self.psi[k], self.matched[k] = registered.psi, registered.matched
        self.statuses[k], self.tried[k] = registered.status, True
        self.on_map[k] = registered.status in ON_MAP
        self._progress("localise", int(self.tried.sum()), len(self.tried))

    def forget(self, part: slice) -> None:
        """Forgets where the scans of a part of the recording lie."""
        self.poses[part] = self.covariances[part] = self.psi[part] = self.matched[part] = np.nan
        self.tried[part] = self.on_map[part] = False


def follow(setting: Setting, table: LocalisedScans, start: int, way: int, limit: int) -> bool:
    """Follows scans from one that lies on the map, until too long a way lies on nothing or another one is reached that does.

    Scans at the end of which none lies on the map are left as not tried, so that they can be reached from the other side.

    Args:
        setting: what scans are followed with.
        table: where each scan lies; it is filled in.
        start: the scan to begin from, which lies on the map.
        way: 1 follows the recording forward in time, -1 backward.
        limit: the last scan to follow.

    Returns:
        Whether a scan was reached that lies elsewhere, as it was followed from the other side.
    """
    around = MapAround(setting.keyframes, setting.beam)
    travelled = setting.drive.travelled
    known, last, lost = table.get(start), start, list[tuple[int, Registered]]()
    for k in range(start + way, limit + way, way):
        prediction = setting.predict(known, k - way, k)
        if table.tried[k]:
            return table.on_map[k] and is_away(se2.wrapped_between(prediction.pose, table.poses[k]), prediction)
        registered = register(around, setting.render(k), prediction, setting.estimator)
        known = Prediction(registered.pose, registered.covariance)
        lost.append((k, registered))
        if registered.status in ON_MAP:
            for number, one in lost:
                table.put(number, one)
            last, lost = k, []
        elif abs(travelled[k] - travelled[last]) > _GIVE_UP_M:
            break
    return False
