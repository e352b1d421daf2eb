"""Small results of every command that writes a page, and their pages."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
from support.keyframe_maps import two_recordings
from support.reported import judged_walls, page_of, swept_walls

from mqslam.auditing.verdict import VerdictStatus
from mqslam.backend.marginals import PoseCovariances
from mqslam.comparison.comparison import Comparison
from mqslam.comparison.judgement import JudgedRow, Place, compare_pairs
from mqslam.comparison.rows import Row
from mqslam.config import Config
from mqslam.core import se2
from mqslam.core.measurement import Measurement, Status
from mqslam.core.point_map import PointMap
from mqslam.core.trajectory import Trajectory
from mqslam.localisation.localise import Localised
from mqslam.localisation.registering import PlaceStatus
from mqslam.mapping.keyframing import render_keyframes
from mqslam.merging.changes import Change
from mqslam.report.audit_page import write_audit_page
from mqslam.report.batch_page import write_batch_page
from mqslam.report.compare_page import write_compare_page
from mqslam.report.localise_page import write_localise_page
from mqslam.report.merge_page import write_merge_page
from mqslam.report.run_page import write_run_page

START_US = 1_600_000_000_000_000
HOSTILE = "polar scan 7 <img src=x> is & stays truncated"
RUN_SUMMARY: dict[str, Any] = {
    "mqslam_version": "9.8.7",
    "dataset": {"format": "oxford", "path": "/data/<run>", "revolutions": 60, "duration_s": 30.0, "length_m": 251.3},
    "psi": {
        "odometry": 132.0,
        "optimised": 99.0,
        "per_point_odometry": 0.033,
        "per_point_optimised": 0.02475,
        "across_passes_odometry": None,
        "across_passes_optimised": None,
        "matched_odometry": 0.71,
        "matched_optimised": 0.82,
    },
    "verdict": {"status": "warn", "reasons": ["torn near t = 31 s & 40 s"]},
    "factors": {"odometry": 59, "psi": 20, "loop": 0, "loop_rejected": 0, "refinement": 0},
    "evaluation": {"ate_rmse_m": 0.312, "drift_percent": None, "drift_deg_per_100m": 0.41, "rpe_w_rms": np.pi / 60.0},
    "sensors": {
        "gyroscope": {"moved_m": 0.25, "turned_rad": np.pi / 180.0, "bias_radps": np.pi / 90.0, "statements": []},
        "gnss": None,
        "chirps": {"moved_m": None, "statements": []},
    },
    "runtime_s": {"read": 1.2, "total": 29.1},
    "peak_rss_mb": 812.5,
    "warnings": [HOSTILE, "odometry ends & the run goes on"],
}
AUDIT_SUMMARY: dict[str, Any] = {
    "mqslam_version": "9.8.7",
    "verdict": {"status": "warn", "reasons": ["1 of 10 windows & 1 of 2 revisits <torn>"]},
    "dataset": {"format": "mulran", "path": "/data/<run>", "sweeps": 60, "length_m": 295.0, "duration_s": 15.0},
    "trajectory": "given & <kept>.tum",
    "windows": {"count": 10, "torn": 1, "inflation_median": 2.4},
    "revisits": {"count": 3, "sure": 2, "torn": 1, "worst_m": None},
    "pooled": {"spans": 9, "yaw_per_m": 0.001, "yaw_per_m_sigma": 0.0001},
    "per_window": [{"t0": 0.0}],
    "warnings": [HOSTILE],
}
COMPARE_SUMMARY: dict[str, Any] = {
    "mqslam_version": "9.8.7",
    "dataset": {"format": "mulran", "path": "/data/<run>", "revolutions": 60, "compared": 50},
    "rows": [{"name": "psi", "scans": 60}, {"name": "_kiss_$icp$ <icp>", "scans": 50}],
    "best": {"rows": ["psi"], "decided_by": "drift", "sentence": "psi is best, <b>and so on</b>."},
    "warnings": [HOSTILE],
}
TABLE = (
    ("", "drift [%]", "verdict", "inflation"),
    ("psi", "0.5", "pass", "2.4"),
    ("_kiss_$icp$ <icp>", "1.1", "fail", "9"),
    ("odometry", "failed", "", ""),
)
MARKED = frozenset({(1, 1), (1, 3), (2, 3)})


def circle(radius: float, scans: int = 60) -> Trajectory:
    angle = np.linspace(0.0, 2.0 * np.pi, scans)
    poses = np.c_[radius * np.sin(angle), radius * (1.0 - np.cos(angle)), angle]
    return Trajectory(START_US + 500_000 * np.arange(scans), poses)


def bow(turn: float, begin: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> Trajectory:
    """Returns a path of 1 m steps that turns by the same angle [rad] at each, from some pose."""
    steps = se2.exp(np.tile([1.0, 0.0, turn], (200, 1)), np.arange(200))
    return Trajectory(START_US + 250_000 * np.arange(200), se2.compose(np.array(begin), steps))


def walls(offset: float, count: int = 4000) -> PointMap:
    rng = np.random.default_rng(11)
    points = np.c_[rng.uniform(-60.0, 60.0, count), rng.choice([-30.0, 90.0], count) + offset * rng.normal(size=count)]
    times, matched = np.sort(rng.uniform(0, 30, count)), rng.random(count) < 0.8
    return PointMap(points, times, rng.uniform(60, 255, count), rng.random(count), matched)


def measured(count: int, with_odometry: bool = True) -> list[Measurement]:
    rng = np.random.default_rng(12)
    return [
        Measurement(
            1.5 * k,
            1.5 * (k + 1),
            np.zeros(3),
            np.eye(3),
            Status.LOST if k == 3 else Status.CONVERGED,
            psi=rng.uniform(20.0, 30.0),
            psi_odometry=rng.uniform(30.0, 45.0) if with_odometry else np.nan,
            points=1000,
            matched=0.8,
        )
        for k in range(count)
    ]


def a_run(**changed: Any) -> Any:
    """Returns what a run's page shows of a run."""
    shown = {
        "odometry": circle(42.0),
        "optimised": circle(40.1),
        "map_odometry": walls(3.0),
        "map_optimised": walls(0.2),
        "measurements": measured(20),
        "before": "odometry",
        "checks": judged_walls(swept_walls()).windows,
        "checked": judged_walls(swept_walls()),
        "config": Config(),
        "doppler_beta": 0.0,
        "loops": [SimpleNamespace(earlier=0, later=59)],
        "covariances": PoseCovariances(np.array([0, 30, 59]), np.diag([0.04, 0.09, 1e-4]) * np.arange(1, 4)[:, None, None]),
    }
    return SimpleNamespace(**{**shown, **changed})


TRUTH = Trajectory(circle(40.0).stamps_us, se2.compose(np.array([500.0, 300.0, 1.0]), circle(40.0).poses))


def write_run(
    folder: Path, summary: dict[str, Any] = RUN_SUMMARY, truth: Trajectory | None = TRUTH, notes: Any = (), **changed: Any
) -> list[str]:
    recording: Any = SimpleNamespace(
        path=Path("/data/<run>"),
        ground_truth=truth,
        notes=notes,
        sensor_name="radar",
        left_out=0,
        complete=lambda track: track,
    )
    return write_run_page(folder, a_run(**changed), recording, summary)


def write_audit(folder: Path, summary: dict[str, Any] = AUDIT_SUMMARY, **changed: Any) -> list[str]:
    sweeps = changed.get("sweeps") or swept_walls()
    return write_audit_page(folder, "<run>", changed.get("audit") or judged_walls(sweeps), sweeps, Config(), summary)


def judged_row(name: str, trajectory: Trajectory) -> JudgedRow:
    rng = np.random.default_rng(len(name))
    row = Row(name, None, trajectory, trajectory)
    crops = tuple(rng.uniform(-50.0, 50.0, (300, 2)) for _ in range(2))
    points = rng.uniform(-50.0, 50.0, (500, 2))
    drawn = PointMap(points, rng.uniform(0.0, 15.0, 500), np.full(500, 80.0), rng.random(500), np.ones(500, bool))
    return JudgedRow(row, 0.6, 0.8, judged_walls(swept_walls()), None, None, None, crops, drawn)


ROWS = (judged_row("psi", bow(0.01)), judged_row("_kiss_$icp$ <icp>", bow(0.012, (30.0, 20.0, 1.0))))


def a_comparison(shown_rows: tuple[JudgedRow, ...] = ROWS, truth: Trajectory | None = None, **changed: Any) -> Comparison:
    recording: Any = SimpleNamespace(
        path=Path("/data/<run>"), ground_truth=truth, notes=(), start_us=START_US, sensor_name="radar"
    )
    shown = {
        "rows": (*(row.row for row in shown_rows), Row("odometry", failure="no odometry; give <FILE>")),
        "places": (Place(6, 12, 1.5, 3.0, 1.25), Place(30, 36, 7.5, 9.0, 0.04)),
        "agreement": tuple(compare_pairs([row.row for row in shown_rows])),
    }
    rest: dict[str, Any] = {
        "best": None,
        "psi_across": {},
        "covered": {},
        "interpolated": {},
        "compared": 60,
        "stations": (),
        "warnings": (),
        "doppler_beta": 0.0,
    }
    judged = {row.row.name: row for row in shown_rows}
    return Comparison(recording=recording, settings=Config(), judged=judged, **{**shown, **rest, **changed})


def write_comparison(
    folder: Path, comparison: Comparison | None = None, summary: dict[str, Any] = COMPARE_SUMMARY
) -> list[str]:
    shown = comparison or a_comparison(truth=bow(0.01, (500.0, 300.0, 2.0)))
    lines = [line for line in TABLE if not line[0] or line[0] in {row.name for row in shown.rows}]
    return write_compare_page(folder, shown, summary, lines, MARKED)


def batched_run(name: str, **changed: Any) -> dict[str, Any]:
    return {
        "name": name,
        "verdict": "pass",
        "reasons": "0 of 40 windows are torn",
        "not_judged": "",
        "failure": None,
        "warnings": "",
        "revolutions": 240,
        "duration_s": 60.0,
        "length_m": 421.3,
        "psi_per_point_odometry": 0.5,
        "psi_per_point": 0.25,
        "matched": 0.976,
        "loops": 3,
        "ate_rmse_m": 0.0262,
        "drift_percent": 0.0319,
        "report": f"{name}/report.html",
        "trajectory": None,
        **changed,
    }


def write_batch(folder: Path) -> list[str]:
    runs = [
        batched_run("good", not_judged="told once below"),
        batched_run("bad", verdict="fail", reasons="33 of 40 windows are <torn>", length_m=2500.0, loops=0, ate_rmse_m=None),
        batched_run("alone", psi_per_point_odometry=None, duration_s=20.0, warnings="the <clock> drifts"),
        {**dict.fromkeys(batched_run("")), "name": "gone", "failure": HOSTILE},
    ]
    counts = dict.fromkeys(VerdictStatus, 0) | {"pass": 2, "fail": 1, "failed": 1}
    notes = {
        "not_judged": [{"text": "on <assumed> range bins rests its scale", "runs": ["good", "alone"]}],
        "warnings": [{"text": "the <clock> drifts", "runs": ["bad", "alone"]}],
    }
    summary = {"mqslam_version": "9.8.7", "counts": counts, "duration_s": 140.0, "length_m": 3342.6, "runs": runs}
    return write_batch_page(folder, "<run>", summary | {"notes": notes}, "runs: []  # <plan>")


def write_merge(folder: Path) -> list[str]:
    made = two_recordings()
    change = Change(0, 1, np.array([3.0, 2.0]), np.array([2.0, 4.5]), 9, 4, 6, 1e-4)
    merged: Any = SimpleNamespace(
        unit_m=1.0,
        config=Config(),
        kept=made,
        map=render_keyframes(made.keyframes),
        trajectories=(circle(3.0), circle(5.0)),
        links=SimpleNamespace(loops=[SimpleNamespace(earlier=0, later=3)]),
        changes=[change],
    )
    numbers = ("compared", "matches", "rows", "agreeing", "rivals", "ambiguous")
    listed = {"shown_by": 1, "missed_by": 2, "x": 3.0, "y": 2.0, "size_x": 2.0, "size_y": 4.5, "seen": 4, "looks": 6}
    summary = {
        "conclusion": "2 recordings <run> are one map",
        "links": {"count": 1, "residual_median": 0.7},
        "psi": {"across_before": 0.5, "across_after": 0.25, "matched": 0.8},
        "recordings": [{"path": "/data/<a>", "scans": 60, "length_m": 18.8, "duration_s": 30.0}] * 2,
        "recognition": [{"earlier": 1, "later": 2, **dict.fromkeys(numbers, 3)}],
        "changes": [listed],
        "warnings": [HOSTILE],
    }
    return write_merge_page(folder, merged, summary)


def write_localised(folder: Path) -> list[str]:
    statuses = (*[PlaceStatus.CONVERGED] * 56, *PlaceStatus)
    sure = np.tile(np.diag([0.01, 0.04, 1e-4]), (60, 1, 1))
    track, matched = circle(3.0), np.append(np.full(59, 0.8), np.nan)
    counts = (1, 1, 1, np.ones(3), 9, 0)
    localised = Localised(track.stamps_us, track.poses, sure, statuses, np.full(60, 0.3), matched, *counts)
    summary = {
        "dataset": {"path": "/data/<run>", "scans": 60},
        "map": {"path": "/data/<map>"},
        "share_on_map": 0.975,
        "median_sigma": {"along_m": 0.1, "across_m": 0.2, "yaw_rad": 0.01},
        "matched": 0.8,
        "psi_per_point": 0.3,
        "evaluation": {"ate_rmse_m": 0.05},
        "scans": {status.value: statuses.count(status) for status in PlaceStatus},
        "warnings": [HOSTILE],
    }
    return write_localise_page(folder, localised, two_recordings(), Config(), summary)


WRITERS: dict[str, Callable[[Path], list[str]]] = {
    "run": write_run,
    "audit": write_audit,
    "compare": write_comparison,
    "batch": write_batch,
    "merge": write_merge,
    "localise": write_localised,
}


def text_of(folder: Path) -> str:
    """Returns the words of a page, one text after the other, without empty lines."""
    return re.sub(r"\n\s*", "\n", page_of(folder / "report.html").text)


def scene_of(folder: Path) -> dict[str, Any]:
    """Returns what the map to move in shows."""
    page = (folder / "report.html").read_text(encoding="utf-8")
    scene = re.search(r'<script type="application/json" id="scene">(.*?)</script>', page, re.DOTALL)
    assert scene is not None
    return json.loads(scene[1])
