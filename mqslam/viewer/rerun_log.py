"""Logs a map scan by scan for Rerun's viewer: to an .rrd file, or to an open viewer while a run tracks the scans."""

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
from mqslam.errors import Remedy, ViewerError
from mqslam.execution.extras import describe_missing
from mqslam.execution.files import write_aside
from mqslam.viewer.scene import GROUND, LOOPS, TRAJECTORY, RunScene, colour_between, colour_over_span, has_display, lift

TIMELINE = "time"
_POINT_M = 0.15  # radius of a point
_LINE_M = 0.2  # radius of a line
_HEADING_M = 3.0  # length of the arrow that shows the sensor's pose


class RerunLog:
    """A map that is written to Rerun scan by scan, along a time line in seconds.

    Args:
        recording: the open `rerun.RecordingStream` to write to.
    """

    def __init__(self, recording: Any) -> None:
        import rerun as rr

        self._recording = recording
        self._last: se2.Array | None = None
        recording.log("/", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
        recording.log("radar/heading", rr.Arrows3D(vectors=[[_HEADING_M, 0.0, 0.0]], colors=[TRAJECTORY]), static=True)

    def add_scan(self, t: float, pose: se2.Array, points: NDArray[np.float64], colours: NDArray[np.uint8]) -> None:
        """Adds a scan: its points, the sensor's pose at its start, and a line from the pose of the scan added before.

        Args:
            t: start of the scan [s] since the recording's start.
            pose: (3,) pose of the sensor at that time: x, y [m], yaw [rad], world frame.
            points: (N, 2) x, y [m] of the scan's returns, world frame.
            colours: (N, 3) red, green, blue of each point, 0..255.
        """
        import rerun as rr

        at = (float(pose[0]), float(pose[1]), 0.0)
        turn = rr.RotationAxisAngle(axis=(0.0, 0.0, 1.0), radians=float(pose[2]))
        self._recording.set_time(TIMELINE, duration=t)
        self._recording.log("radar", rr.Transform3D(translation=at, rotation=turn))
        if self._last is not None:
            self._recording.log("trajectory", _make_lines(np.array([[self._last[:2], pose[:2]]]), TRAJECTORY))
        if len(points):
            self._recording.log("map", rr.Points3D(lift(points), colors=colours, radii=_POINT_M))
        self._last = pose

    def add_scene(self, scene: RunScene, colour: str) -> None:
        """Adds a finished map, scan by scan, and its loop closures.

        Args:
            scene: the map to add.
            colour: name of the values in `scene.values` that colour the points.
        """
        times, colours = scene.start_times, colour_over_span(scene.values[colour])
        ends = np.append(np.searchsorted(scene.values["time"], times[1:]), len(scene.points))
        begin, starts = 0, set(scene.starts.tolist())
        for k, (t, pose, end) in enumerate(zip(times.tolist(), scene.trajectory.poses, ends.tolist(), strict=True)):
            if k in starts:
                self._last = None  # no line joins two recordings
            self.add_scan(t, pose, scene.points[begin:end], colours[begin:end])
            begin = end
        if len(scene.loops):
            self._recording.log("loops", _make_lines(scene.trajectory.poses[scene.loops, :2], LOOPS), static=True)

    def watch(self, scan: Scan, pose: se2.Array, points: NDArray[np.float64]) -> None:
        """Adds a scan that a run has just tracked, with its points coloured by intensity.

        Args:
            scan: the scan.
            pose: (3,) pose of the sensor at the start of the scan: x, y [m], yaw [rad], world frame.
            points: (N, 2) x, y [m] of the scan's returns, world frame.
        """
        self.add_scan(scan.t0, pose, points, colour_between(scan.returns.intensities, 0.0, 255.0))


@contextmanager
def record(path: Path) -> Iterator[RerunLog]:
    """Opens a log that is written to an .rrd file; the file appears only if the `with` block ends without an error.

    Args:
        path: the .rrd file.

    Yields:
        The log.

    Raises:
        ViewerError: Rerun is not installed.
        OutputError: the file cannot be written.
    """
    recording = _open_recording()
    with write_aside(path) as aside:
        recording.save(aside, default_blueprint=_make_blueprint())
        try:
            yield RerunLog(recording)
        finally:
            recording.disconnect()


@contextmanager
def stream() -> Iterator[RerunLog]:
    """Opens a log, and Rerun's viewer, which shows the log as it grows and stays open after the `with` block.

    Yields:
        The log.

    Raises:
        ViewerError: Rerun is not installed, or there is no display.
    """
    recording = _open_recording()
    if not has_display():
        raise ViewerError("there is no display to open Rerun's viewer on", Remedy.RECORD_LIVE_VIEW)
    open_viewer()
    recording.connect_grpc(default_blueprint=_make_blueprint())  # this call waits until the viewer listens
    try:
        yield RerunLog(recording)
    finally:
        recording.disconnect()


def open_viewer(*files: Path) -> None:
    """Opens Rerun's viewer, which stays open after this process.

    Args:
        files: .rrd files to show; if none is given, the viewer waits for a log that is streamed to it.
    """
    command = [sys.executable, "-m", "rerun", *map(str, files)]  # the command `rerun` may not be on the PATH
    subprocess.Popen(command, start_new_session=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)


def _open_recording() -> Any:
    """Returns a new `rerun.RecordingStream`; raises ViewerError if Rerun is not installed."""
    try:
        import rerun as rr
    except ImportError as error:
        raise ViewerError(*describe_missing("view")) from error
    return rr.RecordingStream("mqslam")


def _make_blueprint() -> Any:
    """Returns a layout for Rerun: one view of all that was logged from the beginning up to the time line's cursor."""
    import rerun.blueprint as rrb

    so_far = rrb.VisibleTimeRange(
        TIMELINE, start=rrb.TimeRangeBoundary.infinite(), end=rrb.TimeRangeBoundary.cursor_relative()
    )
    return rrb.Blueprint(rrb.Spatial3DView(name="map", origin="/", background=GROUND, time_ranges=[so_far]))


def _make_lines(segments: NDArray[np.float64], colour: tuple[int, int, int]) -> Any:
    """Returns segments (L, 2, 2), each given by x, y [m] of both ends, as lines of Rerun in a colour red, green, blue."""
    import rerun as rr

    return rr.LineStrips3D([lift(segment) for segment in segments], colors=[colour], radii=_LINE_M)
