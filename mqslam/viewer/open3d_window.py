"""A scene in a window of Open3D: the map from above, keys P, I and T for its colours."""

from __future__ import annotations

import time
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mqslam.errors import ViewerError
from mqslam.viewer.colours import GROUND, LOOPS, TRAJECTORY, spread
from mqslam.viewer.display import has_display
from mqslam.viewer.finished_run import Scene

KEYS = {"psi": "P", "intensity": "I", "time": "T"}
_FRAME_S = 0.02
_ABOVE_M = 0.05  # lines lie above the points


def show(scene: Scene, colour: str) -> None:
    """Show a scene until its window is closed.

    Args:
        scene: it.
        colour: what the points are coloured by at first, one of KEYS.

    Raises:
        ViewerError: there is no display.
    """
    shown = window(scene, colour)
    while shown.poll_events():  # not Open3D's own loop, which hears no Ctrl-C
        shown.update_renderer()
        time.sleep(_FRAME_S)
    shown.destroy_window()


def window(scene: Scene, colour: str) -> Any:
    """An Open3D visualizer that shows a scene from above; the keys are registered."""
    if not has_display():
        raise ViewerError("no display to open a window on; look at report.html, or give --rerun and open map.rrd elsewhere")
    import open3d as o3d

    shown = o3d.visualization.VisualizerWithKeyCallback()
    if not shown.create_window(f"mqslam {scene.name}", 1280, 900):
        raise ViewerError("Open3D cannot open a window on this display; look at report.html, or give --rerun")
    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(_flat(scene.points, 0.0)))
    for geometry in (*_lines(scene), cloud):  # the view is fitted to the last one
        shown.add_geometry(geometry)

    def colour_by(name: str, _: Any = None) -> bool:
        cloud.colors = o3d.utility.Vector3dVector(spread(scene.values[name]) / 255.0)
        return bool(shown.update_geometry(cloud))

    for name, key in KEYS.items():
        shown.register_key_callback(ord(key), partial(colour_by, name))
    colour_by(colour)
    options, view = shown.get_render_option(), shown.get_view_control()
    options.background_color, options.point_size = np.array(GROUND) / 255.0, 2.0
    view.set_front([0.0, 0.0, 1.0])
    view.set_up([0.0, 1.0, 0.0])
    view.change_field_of_view(-90.0)  # as far as it goes: without perspective
    view.set_zoom(0.4)
    return shown


def _lines(scene: Scene) -> list[Any]:
    """The trajectory and the loops."""
    import open3d as o3d

    poses = o3d.utility.Vector3dVector(_flat(scene.trajectory.poses[:, :2], _ABOVE_M))
    steps = np.arange(len(scene.trajectory) - 1)
    found = []
    for ends, colour in ((np.column_stack([steps, steps + 1]), TRAJECTORY), (scene.loops, LOOPS)):
        if len(ends):
            lines = o3d.geometry.LineSet(poses, o3d.utility.Vector2iVector(ends))
            lines.paint_uniform_color(np.array(colour) / 255.0)
            found.append(lines)
    return found


def _flat(points: NDArray[np.float64], z: float) -> NDArray[np.float64]:
    """Points (N, 3) of points (N, 2) [m]."""
    return np.column_stack([points, np.full(len(points), z)])
