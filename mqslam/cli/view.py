"""`mqslam view`: shows a run's map, trajectory and loops in a window."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path

from mqslam.cli.options import Options, argument, command, flag, option
from mqslam.cli.terminal import Terminal, echo


class Colour(StrEnum):
    """The quantity that colours the points of a map."""

    psi = "psi"
    intensity = "intensity"
    time = "time"


_OWN: Options = {
    "out": argument(Path, ..., "OUT", "The folder of a finished run, or of keyframes."),
    "colour": option(Colour, Colour.psi, "The quantity that colours the points at first."),
    "rerun": flag("Write OUT/map.rrd and open it in Rerun's viewer; this needs the extra `view`.", "--rerun"),
}


@command("out colour rerun quiet verbose", _OWN)
def view(terminal: Terminal, *, out: Path, colour: Colour, rerun: bool) -> None:
    """Show the map of a run in a window, with its trajectory (white) and its loops (pink).

    Bright points have a high psi, a high intensity or a late time. In the window, the keys P, I and T choose between psi,
    intensity and time; the wheel zooms, the mouse turns the map, and Q closes the window. If a folder holds keyframes but no
    map.ply, the keyframes are shown; they have no psi, and are coloured by intensity instead.

    Example: mqslam view result --colour time
    """
    from mqslam.viewer.scene import read_scene

    scene = read_scene(out)
    by = colour.value if colour.value in scene.values else Colour.intensity.value
    if not rerun:
        from mqslam.viewer.open3d_window import show

        show(scene, by)
        return
    from mqslam.viewer.rerun_log import open_viewer, record
    from mqslam.viewer.scene import has_display

    path = out / "map.rrd"
    with record(path) as log:
        log.add_scene(scene, by)
    outcome = "written; there is no display here, so open it elsewhere with: rerun map.rrd"
    if has_display():
        open_viewer(path)
        outcome = "opened in Rerun's viewer"
    if not terminal.quiet:
        echo(f"{path}: {outcome}")
