"""Merges of two runs against the truth: how the runs lie to each other, and whether every link is true."""

from __future__ import annotations

import csv
import shutil
import subprocess
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from bench.benchmark import Cell, Column, Goal, Row, label
from bench.measuring.commands import read_json
from bench.measuring.recordings import MQSLAM
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from mqslam.core import se2
from mqslam.core.keyframes import KeyframeMap, PlaceTable
from mqslam.core.trajectory import Trajectory
from mqslam.formats.maps.keyframe_folder import FOLDER, read_keyframes, write_keyframes
from mqslam.formats.tum import read_tum

_SAME_M, _SAME_RAD = 3.0, 0.3  # two scans whose true poses are so near to each other are at the same place
_WRONG_M, _WRONG_RAD = 1.0, 0.03  # a link that is off by more than this is wrong
COLUMNS = (
    label("case", "case"),
    Column("outcome", "outcome", "{}", label=True),
    Column("rms_m", "runs against each other, RMS [m]", "{:.3f}", Goal.LOW),
    Column("worst_m", "at most [m]", "{:.2f}"),
    Column("links", "links", "{:.0f}"),
    Column("wrong", "wrong links", "{:.0f}"),
    Column("before", "psi across before", "{:.3f}"),
    Column("after", "after", "{:.3f}"),
)


class Pair(NamedTuple):
    """Two results, and the truth of both.

    Args:
        results: folders.
        truths: in one world frame.
    """

    results: tuple[Path, Path]
    truths: tuple[Trajectory, Trajectory]


def move_result(source: Path, out: Path, frame: NDArray[np.float64], first: int) -> Path:
    """Writes a result whose keyframes lie in another frame and begin later, and returns its folder.

    Args:
        source: the result.
        out: the new folder.
        frame: (3,) pose of the present frame in the new one [m, m, rad].
        first: number of the first keyframe that stays.
    """
    out.mkdir(parents=True)
    for name in ("graph.g2o", "trajectory.tum", "config.yaml"):
        shutil.copy(source / name, out / name)
    kept = read_keyframes(source).carry(frame)
    own, places = kept.keyframes, kept.places
    names = ("origins", "scans", "stamps_us", "poses", "covariances", "travelled", "rows")
    keyframes = replace(own, **{name: getattr(own, name)[first:] for name in names})
    stay = places.keyframes >= first
    table = PlaceTable(places.keyframes[stay] - first, np.asarray(places.descriptors)[stay], places.made_with)
    write_keyframes(out / FOLDER, KeyframeMap(keyframes, table))
    return out


def measure_merge(case: str, pair: Pair, out: Path) -> Row:
    """Returns the row of a merge; one that is refused has no links.

    Args:
        case: as the table shows it.
        pair: what is merged.
        out: folder for the result.
    """
    words = [MQSLAM, "merge", *pair.results, "--out", out, "--quiet", "--force"]
    done = subprocess.run(words, check=False, capture_output=True, text=True)
    if done.returncode == 2 and "shares no place" in done.stderr:
        outcome = "refused: several places fit" if "several places fit" in done.stderr else "refused"
        return Row({"case": case, "outcome": outcome, "links": 0.0, "wrong": 0.0})
    done.check_returncode()
    summary = read_json(out / "summary.json")
    errors = _compare_tracks(out, pair.truths)
    cells: dict[str, Cell] = {
        "case": case,
        "outcome": "merged",
        "rms_m": float(np.sqrt(np.mean(errors**2))),
        "worst_m": float(errors.max()),
        "links": float(summary["links"]["count"]),
        "wrong": float(_count_wrong(out / "links.csv", pair.truths)),
        "before": summary["psi"]["across_before"],
        "after": summary["psi"]["across_after"],
    }
    return Row(cells)


def _compare_tracks(out: Path, truths: tuple[Trajectory, Trajectory]) -> NDArray[np.float64]:
    """Returns how far (N,) [m] the runs are apart beyond the truth at the same places, the first laid on the truth."""
    tracks = [read_tum(out / f"trajectory_{n}.tum") for n in (1, 2)]
    true = [_place(truth, track.stamps_us) for truth, track in zip(truths, tracks, strict=True)]
    motion = _align(tracks[0].poses[:, :2], true[0][:, :2])
    off = [se2.transform(motion, track.poses[:, :2]) - at[:, :2] for track, at in zip(tracks, true, strict=True)]
    apart, nearest = cKDTree(true[0][:, :2]).query(true[1][:, :2])
    turned = np.abs(se2.wrap(true[1][:, 2] - true[0][nearest, 2]))
    same = (apart < _SAME_M) & (turned < _SAME_RAD)
    return np.asarray(np.hypot(*(off[1][same] - off[0][nearest[same]]).T))


def _count_wrong(path: Path, truths: tuple[Trajectory, Trajectory]) -> int:
    """Returns how many links of a table are off the truth."""
    wrong = 0
    for row in csv.DictReader(path.read_text(encoding="utf-8").splitlines()):
        ends = [
            _place(truths[int(row[f"{end}_recording"]) - 1], np.array([int(row[f"{end}_stamp"].replace(".", ""))]))[0]
            for end in ("earlier", "later")
        ]
        off = se2.between(se2.between(*ends), np.array([float(row[name]) for name in ("x", "y", "yaw")]))
        wrong += bool(np.hypot(off[0], off[1]) > _WRONG_M or abs(se2.wrap(off[2])) > _WRONG_RAD)
    return wrong


def _place(truth: Trajectory, stamps_us: NDArray[np.int64]) -> NDArray[np.float64]:
    """Returns the true poses (N, 3) at stamps (N,) [us]."""
    start = truth.stamps_us[0]
    return se2.interpolate((truth.stamps_us - start) * 1e-6, truth.poses, (stamps_us - start) * 1e-6)


def _align(points: NDArray[np.float64], onto: NDArray[np.float64]) -> NDArray[np.float64]:
    """Returns the rigid motion (3,) that lays points (N, 2) best on others (N, 2)."""
    middle, there = points.mean(axis=0), onto.mean(axis=0)
    a, b = points - middle, onto - there
    yaw = np.arctan2(np.sum(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]), np.sum(a * b))
    turned = se2.transform(np.array([0.0, 0.0, yaw]), middle[None])[0]
    return np.array([*(there - turned), yaw])
