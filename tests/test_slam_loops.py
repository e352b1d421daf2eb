"""A drive that comes back to where it was is tied there, and its trajectory is better for it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from support.drives import drive_around_a_block

from mqslam.config import Config, LoopConfig, RefinementConfig, SensorConfig
from mqslam.core import se2
from mqslam.evaluation import evaluate
from mqslam.execution.checkpoint import Checkpoint
from mqslam.execution.folders import CHECKPOINT
from mqslam.execution.local_engine import LocalEngine
from mqslam.execution.runner import Runner
from mqslam.formats.graphs.g2o import format_g2o
from mqslam.results.run_results import summarise
from mqslam.simulator import SimulatedRecording
from mqslam.slam import Slam
from mqslam.solution import Run

CONFIG = Config(sensor=SensorConfig(doppler_beta=0.0), refinement=RefinementConfig(rounds=2))


def slam(recording: SimulatedRecording, config: Config, jobs: int, out: Path, *, resume: bool) -> Run:
    """Runs the recording by radar alone, with the returns and measurements of an earlier run where they are to be used."""
    for name in ("loops.npz", "refinement.npz"):
        (out / CHECKPOINT / name).unlink(missing_ok=True)
    checkpoint = Checkpoint(out, "lap", resume=resume)
    return Slam(config, "psi", Runner(LocalEngine(jobs), checkpoint=checkpoint)).run(recording, None)


@pytest.fixture(scope="module")
def out(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Where the lap's returns and measurements are kept."""
    return tmp_path_factory.mktemp("lap")


@pytest.fixture(scope="module")
def lap() -> SimulatedRecording:
    """A bit more than one round of a block, whose second pass loops leave about a hundredth of psi off the first."""
    return drive_around_a_block(60.0, seed=4)


@pytest.fixture(scope="module")
def run(lap: SimulatedRecording, out: Path) -> Run:
    """The lap, refined after its loops."""
    return slam(lap, CONFIG, 1, out, resume=False)


def test_a_second_pass_is_tied_to_the_first(run: Run, lap: SimulatedRecording) -> None:
    summary = summarise(run, lap)
    assert summary["factors"]["loop"] == len(run.loops) > 5
    assert summary["factors"]["loop_rejected"] == run.loops_rejected >= 0
    assert min(loop.later - loop.earlier for loop in run.loops) > 150


def test_every_loop_in_the_graph_is_true(run: Run, lap: SimulatedRecording) -> None:
    assert lap.ground_truth is not None
    truth = lap.ground_truth.poses
    for loop in run.loops:
        error = loop.pose - se2.between(truth[loop.earlier], truth[loop.later])
        assert np.hypot(error[0], error[1]) < 0.15 and abs(se2.wrap(error[2])) < 0.005


def test_loops_bring_the_trajectory_closer_to_truth(run: Run, lap: SimulatedRecording) -> None:
    assert lap.ground_truth is not None
    before, after = (evaluate(track, lap.ground_truth).ate_rmse_m for track in (run.odometry, run.optimised))
    assert before is not None and after is not None
    assert after < 0.6 * before and after < 0.15


def test_loops_are_edges_of_the_graph_as_written(run: Run) -> None:
    text = format_g2o(run.graph.factors, run.values, run.graph.size)
    edges = [line.split()[1:3] for line in text.splitlines() if line.startswith("EDGE_SE2")]
    far = {(int(a), int(b)) for a, b in edges if int(b) - int(a) > 1}
    assert far == {(tie.earlier, tie.later) for tie in [*run.refined.loops, *run.refined.ties]}


def test_psi_across_passes_falls_with_the_loops_and_again_with_the_refinement(run: Run, lap: SimulatedRecording) -> None:
    refined, summary = run.refined, summarise(run, lap)
    assert summary["psi"]["across_passes_odometry"] == refined.psi_before
    assert summary["psi"]["across_passes_optimised"] == refined.psi_across
    assert refined.psi_before is not None and refined.psi_loops is not None and refined.psi_across is not None
    assert refined.psi_across < refined.psi_loops < refined.psi_before
    assert summary["factors"]["refinement"] == len(refined.ties) > 5
    assert any(reason.startswith("psi per point across passes is") for reason in summary["verdict"]["reasons"])


def test_a_resumed_run_finds_the_refinement_again(run: Run, lap: SimulatedRecording, out: Path) -> None:
    again = Slam(CONFIG, "psi", Runner(LocalEngine(1), checkpoint=Checkpoint(out, "lap", resume=True))).run(lap, None)
    assert repr(again.refined) == repr(run.refined)
    np.testing.assert_array_equal(again.optimised.poses, run.optimised.poses)


def test_the_number_of_jobs_changes_no_loop_and_no_pose(run: Run, lap: SimulatedRecording, out: Path) -> None:
    again = slam(lap, CONFIG, 2, out, resume=True)
    np.testing.assert_array_equal(again.optimised.poses, run.optimised.poses)
    assert [(a.earlier, a.later, *a.pose) for a in again.loops] == [(b.earlier, b.later, *b.pose) for b in run.loops]
    np.testing.assert_array_equal(again.map_optimised.psi, run.map_optimised.psi)


def test_loops_can_be_left_out(run: Run, lap: SimulatedRecording, out: Path) -> None:
    without = slam(lap, CONFIG.model_copy(update={"loops": LoopConfig(enabled=False)}), 1, out, resume=True)
    assert without.loops == [] and summarise(without, lap)["factors"]["loop"] == 0 == without.loops_rejected
    np.testing.assert_array_equal(without.odometry.poses, run.odometry.poses)
    assert not np.allclose(without.optimised.poses, run.optimised.poses, atol=0.02)
