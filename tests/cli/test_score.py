"""`mqslam score`: the numbers are the library's, only the window is read, mistakes are one line."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.commands import mqslam, read_contents

from mqslam.commands.score import _describe_estimate
from mqslam.config import Config, PsiConfig
from mqslam.core.motion import CONSTANT_TWIST, CONSTANT_VELOCITY
from mqslam.core.scans import Returns
from mqslam.detection.stage import detect_stretch
from mqslam.formats.recordings import open_recording
from mqslam.psi.minimiser import kernel_of
from mqslam.psi.place import beam_of, place
from mqslam.psi.published.equations import score
from mqslam.psi.window import Window

TURN_S = 0.25
SPEED = 9.0  # of the street's drive [m/s]
BEAM = beam_of(Config().estimator, 0.0)


def window(street: Path, first: int, scans: int) -> Returns:
    recording = open_recording(street)
    return Returns.concatenate(detect_stretch(recording, Config().detector, first, first + scans).returns)


def shown(street: Path, *words: str | float) -> dict[str, Any]:
    result = mqslam("score", street, "--json", *words)
    assert (result.code, result.err) == (0, "")
    scores: dict[str, Any] = json.loads(result.out)
    return scores


@pytest.mark.parametrize("options", [{}, {"temporal": "gaussian", "numerator": "tau", "factor": "kappa", "unmatched": 0.0}])
@pytest.mark.parametrize("motion", ["9,0.02", "8.5,0.1,-0.02"])
def test_the_numbers_are_those_of_the_library(street: Path, motion: str, options: dict[str, Any]) -> None:
    words = [word for name, value in options.items() for word in (f"--{name}", value)]
    scores = shown(street, "--start", 1.1, "--motion", motion, "--revolutions", 3, *words)
    returns = window(street, 5, 3)  # the first that begins at 1.1 s or later
    theta = np.array([float(part) for part in motion.split(",")])
    model = CONSTANT_VELOCITY if len(theta) == 2 else CONSTANT_TWIST
    points = place(returns, 1.25, np.zeros(3), theta, model, BEAM)
    config = PsiConfig(**options)
    expected = score(points.points, points.times, TURN_S, config, points.jacobians[:, :, 3:])
    assert scores["window"] == {"t0": 1.25, "revolutions": 3, "revolution_s": TURN_S, "points": len(returns)}
    assert scores["motion"] == dict(zip(model.parameters, theta.tolist(), strict=True))
    published = scores["published"]
    assert published["psi"] == pytest.approx(expected.psi)
    assert published["psi"] == pytest.approx(published["pair_sum"] + published["charge"])
    assert (published["charge"] == 0.0) == (config.unmatched == 0.0)
    assert published["pairs"] == expected.pairs
    assert published["matched"] == pytest.approx(expected.matched.mean())
    assert published["psi_per_point"] == pytest.approx(expected.psi / len(returns))
    assert list(published["gradient"].values()) == pytest.approx(expected.gradient.tolist())
    assert scores["variant"]["temporal"] == config.temporal and scores["variant"]["unmatched"] == config.unmatched


def test_minimising_gives_what_the_estimator_does(street: Path) -> None:
    best = shown(street, "--start", 2.0, "--motion", "8,0.05", "--minimise")
    config = Config().estimator
    seen = Window(window(street, 8, 3), 2.0, kernel_of(config, TURN_S), config, BEAM)
    expected = seen.estimate(np.array([8.0, 0.0, 0.05]), CONSTANT_VELOCITY)
    minimum = best["minimised"]
    assert list(minimum["motion"].values()) == pytest.approx(expected.theta.tolist())
    assert list(minimum["standard_deviation"].values()) == pytest.approx(np.sqrt(np.diag(expected.covariance)).tolist())
    assert minimum["status"] == expected.status.value
    assert minimum["motion"]["v"] == pytest.approx(SPEED, abs=0.3)
    assert minimum["estimator"]["psi"] == pytest.approx(expected.minimum.evaluation.psi)
    assert minimum["estimator"]["psi"] < best["estimator"]["psi"]


def test_a_sideways_start_is_minimised_over_three_parameters(street: Path) -> None:
    minimum = shown(street, "--start", 2.0, "--motion", "8.5,0.2,0.05", "--minimise")["minimised"]
    assert list(minimum["motion"]) == ["vx", "vy", "omega"]
    assert minimum["motion"]["vx"] == pytest.approx(SPEED, abs=0.3)


def test_the_estimators_gradient_points_uphill(street: Path) -> None:
    slow, fast = (shown(street, "--start", 2.0, "--motion", f"{v},0") for v in (SPEED - 0.3, SPEED + 0.3))
    assert slow["estimator"]["gradient"]["v"] < 0.0 < fast["estimator"]["gradient"]["v"]


def test_a_person_reads_the_parts_and_the_variant(street: Path) -> None:
    result = mqslam("score", street, "--start", 2.0, "--motion", "9,0", "--minimise", "--unmatched", 0)
    assert (result.code, result.err) == (0, "")
    for words in ("published psi", "pair sum (4)", "charge", "matched", "gradient", "temporal plateau", "unmatched 0"):
        assert words in result.out
    for words in ("estimator's psi", "minimised", "+-", "before", "after", "converged"):
        assert words in result.out


def test_a_person_reads_which_minimum_is_found_and_within_what_radius_points_match(street: Path) -> None:
    out = mqslam("score", street, "--start", 2.0, "--motion", "9,0", "--minimise").out
    assert "the minimum nearest to the given motion" in out and "the settings state no shift" in out
    assert "have a neighbour within 2 m" in out and "have a neighbour within 0.6 m" in out
    assert "0.01 s" in mqslam("score", street, "--start", 2.0, "--motion", "9,0", "--set", "sensor.doppler_beta=0.01").out


def test_a_search_that_runs_out_of_steps_says_so(street: Path) -> None:
    words = ("--start", 2.0, "--motion", "4,0", "--minimise")
    assert shown(street, *words)["minimised"]["settled"] is False
    assert "still moving after its last step" in mqslam("score", street, *words).out


def test_a_covariance_that_leaves_the_motion_open_is_degenerate(street: Path) -> None:
    config = Config().estimator
    seen = Window(window(street, 8, 3), 2.0, kernel_of(config, TURN_S), config, BEAM)
    best = seen.estimate(np.array([SPEED, 0.0, 0.0]), CONSTANT_VELOCITY)
    assert _describe_estimate(seen, best, CONSTANT_VELOCITY)["status"] == "converged"
    wide = replace(best, covariance=np.diag([12.0, 0.3]) ** 2)
    assert _describe_estimate(seen, wide, CONSTANT_VELOCITY)["status"] == "degenerate"


def test_a_motion_may_begin_with_a_minus(street: Path) -> None:
    assert shown(street, "--start", 0, "--motion", "-1,0")["motion"] == {"v": -1.0, "omega": 0.0}


def test_only_the_windows_scans_are_read(street: Path, tmp_path: Path) -> None:
    copy = tmp_path / "drive"
    shutil.copytree(street, copy)
    images = sorted((copy / "radar").iterdir())
    for k, image in enumerate(images):
        if k not in (0, 47, *range(8, 11)):  # the first and the last tell the extent
            image.write_bytes(image.read_bytes()[:200])
    again, whole = (shown(drive, "--start", 2.0, "--motion", "9,0") for drive in (copy, street))
    assert again == whole


def test_the_last_window_can_be_scored_and_nothing_is_written(street: Path) -> None:
    before = read_contents(street)
    assert shown(street, "--start", 11.25, "--motion", "9,0")["window"]["t0"] == 11.25
    assert read_contents(street) == before


def test_a_window_without_returns_is_said(street: Path, tmp_path: Path) -> None:
    settings = tmp_path / "blind.yaml"
    settings.write_text("detector: {threshold: 255, contrast: 1.0e6}\n")
    result = mqslam("score", street, "--start", 0, "--motion", "9,0", "--config", settings)
    assert result.code == 2 and "the 3 scans from 0 s on hold no returns; lower detector.threshold" in result.err
