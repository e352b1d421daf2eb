"""A map for Rerun's viewer, revolution by revolution: into a file, or into a viewer while it is measured."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mqslam.core import se2
from mqslam.core.scans import Scan
from mqslam.errors import ViewerError
from mqslam.execution.files import write_aside
from mqslam.viewer.colours import GROUND, LOOPS, TRAJECTORY, rgb, spread
from mqslam.viewer.display import has_display
from mqslam.viewer.finished_run import Scene

TIMELINE = "time"
_POINT_M = 0.15  # radius of a point
_LINE_M = 0.2  # radius of a line
_HEADING_M = 3.0  # length of the arrow that shows the sensor's pose


class RerunLog:
    """A Rerun recording that grows along its time line.

    Args:
        recording: an open `rerun.RecordingStream`.
    """

    def __init__(self, recording: Any) -> None:
        import rerun as rr

        self._recording = recording
        self._last: se2.Array | None = None
        recording.log("/", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
        recording.log("radar/heading", rr.Arrows3D(vectors=[[_HEADING_M, 0.0, 0.0]], colors=[TRAJECTORY]), static=True)

    def revolution(self, t: float, pose: se2.Array, points: NDArray[np.float64], colours: NDArray[np.uint8]) -> None:
        """Add a revolution: its points, the sensor's pose at its start, and the way there from the one before.

        Args:
            t: its start [s] since the recording's start.
            pose: (3,) world frame.
            points: (N, 2) [m] world frame.
            colours: (N, 3) of the points.
        """
        import rerun as rr

        at = (float(pose[0]), float(pose[1]), 0.0)
        turn = rr.RotationAxisAngle(axis=(0.0, 0.0, 1.0), radians=float(pose[2]))
        self._recording.set_time(TIMELINE, duration=t)
        self._recording.log("radar", rr.Transform3D(translation=at, rotation=turn))
        if self._last is not None:
            self._recording.log("trajectory", _lines(np.array([[self._last[:2], pose[:2]]]), TRAJECTORY))
        if len(points):
            self._recording.log("map", rr.Points3D(_flat(points), colors=colours, radii=_POINT_M))
        self._last = pose

    def scene(self, scene: Scene, colour: str) -> None:
        """Add a finished map, coloured by one of its values: every revolution at its time, and the loops."""
        times, colours = scene.start_times, spread(scene.values[colour])
        ends = np.append(np.searchsorted(scene.values["time"], times[1:]), len(scene.points))
        begin = 0
        for t, pose, end in zip(times.tolist(), scene.trajectory.poses, ends.tolist(), strict=True):
            self.revolution(t, pose, scene.points[begin:end], colours[begin:end])
            begin = end
        if len(scene.loops):
            self._recording.log("loops", _lines(scene.trajectory.poses[scene.loops, :2], LOOPS), static=True)

    def watch(self, scan: Scan, pose: se2.Array, points: NDArray[np.float64]) -> None:
        """Add a revolution as it is measured; its points are coloured by intensity."""
        self.revolution(scan.t0, pose, points, rgb(scan.returns.intensities, 0.0, 255.0))


@contextmanager
def recorded(path: Path) -> Iterator[RerunLog]:
    """A log that becomes an .rrd file when the block ends without an error.

    Raises:
        ViewerError: Rerun is not installed.
        OutputError: the file cannot be written.
    """
    recording = _recording()
    with write_aside(path) as aside:
        recording.save(aside, default_blueprint=_blueprint())
        try:
            yield RerunLog(recording)
        finally:
            recording.disconnect()


@contextmanager
def streamed() -> Iterator[RerunLog]:
    """A log that a viewer shows as it grows; the viewer outlives the block.

    Raises:
        ViewerError: Rerun is not installed, or there is no display.
    """
    recording = _recording()
    if not has_display():
        raise ViewerError("no display to open Rerun's viewer on; give --live FILE.rrd and open the file elsewhere")
    open_viewer()
    recording.connect_grpc(default_blueprint=_blueprint())  # waits for the viewer to listen
    try:
        yield RerunLog(recording)
    finally:
        recording.disconnect()


def open_viewer(*files: Path) -> None:
    """Open Rerun's viewer on .rrd files, or to wait for what is streamed to it; it outlives this process."""
    command = [sys.executable, "-m", "rerun", *map(str, files)]  # not by its name, which may not be on the PATH
    subprocess.Popen(command, start_new_session=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)


def _recording() -> Any:
    try:
        import rerun as rr
    except ImportError as error:
        raise ViewerError("Rerun is not installed; pip install 'mqslam[view]'") from error
    return rr.RecordingStream("mqslam")


def _blueprint() -> Any:
    """One view, which shows everything from the beginning up to the time line's cursor."""
    import rerun.blueprint as rrb

    so_far = rrb.VisibleTimeRange(
        TIMELINE, start=rrb.TimeRangeBoundary.infinite(), end=rrb.TimeRangeBoundary.cursor_relative()
    )
    return rrb.Blueprint(rrb.Spatial3DView(name="map", origin="/", background=GROUND, time_ranges=[so_far]))


def _lines(segments: NDArray[np.float64], colour: tuple[int, int, int]) -> Any:
    """Lines of segments (L, 2, 2) [m]."""
    import rerun as rr

    return rr.LineStrips3D([_flat(segment) for segment in segments], colors=[colour], radii=_LINE_M)


def _flat(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Points (N, 3) of points (N, 2) [m]."""
    return np.column_stack([points, np.zeros(len(points))])
