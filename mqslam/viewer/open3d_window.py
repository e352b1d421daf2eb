"""Shows a map from above in a window of Open3D; the keys P, I and T colour its points by psi, intensity or time."""

from __future__ import annotations

import time
from functools import partial
from typing import Any

import numpy as np

from mqslam.errors import Remedy, ViewerError
from mqslam.execution.extras import describe_missing
from mqslam.viewer.scene import GROUND, LOOPS, TRAJECTORY, RunScene, colour_over_span, has_display, lift

KEYS = {"psi": "P", "intensity": "I", "time": "T"}
_FRAME_S = 0.02  # time between two updates of the window
_ABOVE_M = 0.05  # height of lines above the points, so that no point hides a line


def show(scene: RunScene, colour: str) -> None:
    """Shows a scene until its window is closed.

    Args:
        scene: the scene.
        colour: name of the values that colour the points at first: a name in both `KEYS` and `scene.values`.

    Raises:
        ViewerError: there is no display, or Open3D cannot use it or cannot be imported.
    """
    shown = open_window(scene, colour)
    while shown.poll_events():  # Open3D's own loop would not react to Ctrl-C
        shown.update_renderer()
        time.sleep(_FRAME_S)
    shown.destroy_window()


def open_window(scene: RunScene, colour: str) -> Any:
    """Opens a window, an `open3d.visualization.VisualizerWithKeyCallback`, whose keys `KEYS` change the scene's colours.

    Arguments and errors are those of `show`.
    """
    if not has_display():
        raise ViewerError("there is no display to open a window on", Remedy.OPEN_MAP_ELSEWHERE)
    try:
        import open3d as o3d
    except ModuleNotFoundError as error:
        missing, remedy = describe_missing("open3d")
        raise ViewerError(f"the window needs Open3D, and {missing}", remedy, Remedy.OPEN_MAP_ELSEWHERE) from error
    except (ImportError, OSError) as error:  # Open3D is installed, but a system library that it loads is not
        raise ViewerError(f"Open3D cannot be imported ({error})", Remedy.OPEN_MAP_ELSEWHERE) from error

    shown = o3d.visualization.VisualizerWithKeyCallback()
    if not shown.create_window(f"mqslam {scene.name}", 1280, 900):
        raise ViewerError("Open3D cannot open a window on this display", Remedy.OPEN_MAP_ELSEWHERE)
    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(lift(scene.points)))
    for geometry in (*_make_lines(scene), cloud):  # Open3D fits the view to the geometry that is added last
        shown.add_geometry(geometry)

    def colour_by(name: str, _: Any = None) -> bool:
        cloud.colors = o3d.utility.Vector3dVector(colour_over_span(scene.values[name]) / 255.0)
        return bool(shown.update_geometry(cloud))

    for name, key in KEYS.items():
        if name in scene.values:
            shown.register_key_callback(ord(key), partial(colour_by, name))
    colour_by(colour)
    options, view = shown.get_render_option(), shown.get_view_control()
    options.background_color, options.point_size = np.array(GROUND) / 255.0, 2.0
    view.set_front([0.0, 0.0, 1.0])
    view.set_up([0.0, 1.0, 0.0])
    view.change_field_of_view(-90.0)  # the smallest field of view has no perspective
    view.set_zoom(0.4)
    return shown


def _make_lines(scene: RunScene) -> list[Any]:
    """Returns Open3D line sets: one for the trajectory and one for the loop closures, each left out if it has no line."""
    import open3d as o3d

    poses = o3d.utility.Vector3dVector(lift(scene.trajectory.poses[:, :2], _ABOVE_M))
    steps = np.setdiff1d(np.arange(len(scene.trajectory) - 1), scene.starts - 1)  # no line joins two recordings
    shown = []
    for ends, colour in ((np.column_stack([steps, steps + 1]), TRAJECTORY), (scene.loops, LOOPS)):
        if len(ends):
            lines = o3d.geometry.LineSet(poses, o3d.utility.Vector2iVector(ends))
            lines.paint_uniform_color(np.array(colour) / 255.0)
            shown.append(lines)
    return shown
