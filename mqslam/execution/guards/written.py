"""What mqslam writes into folders, by name: nothing else in a folder is ever removed."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterable
from pathlib import Path, PurePosixPath

CHECKPOINT = "checkpoint"  # folder in a result, of a run that is not finished
_RESULTS = """
    summary.json audit.json compare.json batch.json config.yaml run.log report.html
    trajectory.tum trajectory_*.tum odometry.tum ground_truth.tum mended.tum trajectory_at_truth.tum trajectory.geojson
    measurements.csv covariances.csv poses.csv graph.g2o graph.csv links.csv changes.csv compare.csv batch.csv
    audit.csv steps.csv spans.csv revisits.csv bad_places.csv bad_places.geojson heatmap.png overlay.png
    map.ply map.pgm map.yaml map.tif map.rrd keyframes/index.json keyframes/*.npy figure2.png figure3.png boreas-*.txt
"""
_ROWS = "*/trajectory.tum */trajectory.kitti */times.txt */odometry.tum */measurements.csv */covariances.csv"  # of compare
_RECORDINGS = """
    radar.timestamps radar/*.png gt/radar_odometry.csv gt/poses_tum.txt odom.csv imu.csv gnss.csv recording.json
    simulation.json applanix/radar_poses.csv calib/*.txt global_pose.csv sensor_data/radar/polar/*.png
    sensor_data/radar/polar_oxford_form/*.png Navtech_Polar.txt Navtech_Polar/*.png metadata.yaml *.db3
"""
_UNFINISHED = """
    checkpoint/run.json checkpoint/returns-*-*.npz checkpoint/measurements.npz checkpoint/loops.npz
    checkpoint/refinement.npz checkpoint/along.npz checkpoint/.run.json.* checkpoint/.*.npz.*
"""
_NAMES = (*_RESULTS.split(), *_RECORDINGS.split(), *_UNFINISHED.split())


def list_entries(folder: Path) -> list[PurePosixPath]:
    """Lists the files, links and empty folders below a folder, relative to it; no link is followed."""
    entries = []
    for root, folders, files in os.walk(folder):
        inside = PurePosixPath(Path(root).relative_to(folder).as_posix())
        links = [name for name in folders if (Path(root) / name).is_symlink()]
        entries += [inside / name for name in (*files, *links)]
        if not folders and not files and Path(root) != folder:
            entries.append(inside)
    return entries


def list_written(folder: Path, entries: Iterable[PurePosixPath]) -> list[PurePosixPath]:
    """Returns those of a folder's entries that bear the names of what mqslam writes."""
    names = (*_NAMES, *_ROWS.split()) if (folder / "compare.json").is_file() else _NAMES
    return [entry for entry in entries if any(_matches(entry, name) for name in names)]


def remove_entries(folder: Path, entries: Iterable[PurePosixPath]) -> None:
    """Removes files below a folder, as far as they are there, and the folders between that hold nothing any more."""
    for entry in entries:
        with contextlib.suppress(OSError):
            (folder / entry).unlink()
        for parent in entry.parents[:-1]:
            with contextlib.suppress(OSError):
                (folder / parent).rmdir()


def remove_checkpoint(out: Path) -> None:
    """Removes what an unfinished run has kept in its result folder."""
    inside = [PurePosixPath(CHECKPOINT) / entry for entry in list_entries(out / CHECKPOINT)]
    remove_entries(out, list_written(out, inside))
    with contextlib.suppress(OSError):
        (out / CHECKPOINT).rmdir()


def carry_over(folder: Path, out: Path) -> None:
    """Moves all that is below a folder to the same place in another; where that is taken, `.kept` is added to the name."""
    for entry in list_entries(folder):
        target = out / entry
        while os.path.lexists(target):
            target = target.with_name(f"{target.name}.kept")
        with contextlib.suppress(OSError):  # it stays where it is
            target.parent.mkdir(parents=True, exist_ok=True)
            (folder / entry).rename(target)
        remove_entries(folder, [entry / "moved"])  # the folders that are empty now
    with contextlib.suppress(OSError):
        folder.rmdir()


def _matches(entry: PurePosixPath, name: str) -> bool:
    """Returns whether an entry bears a name, in which `*` stands for a part of a file's or a folder's name."""
    return len(entry.parts) == name.count("/") + 1 and entry.match(name)
