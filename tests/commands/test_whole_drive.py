"""A graph of one's own, built step by step, comes to the loops, the ties and the poses of a whole run."""

from __future__ import annotations

import gtsam
import numpy as np
import pytest
from gtsam.symbol_shorthand import A, B
from support.drives import block_drive

from mqslam.backend.pose_graph import poses_of
from mqslam.commands.own_graph import loop_factors, psi_factors, refine
from mqslam.config import Config, RefinementConfig, SensorConfig
from mqslam.core.frontend import Context
from mqslam.factors.between import prior
from mqslam.slam import Slam

CONFIG = Config(sensor=SensorConfig(doppler_beta=0.0), refinement=RefinementConfig(rounds=2))


@pytest.mark.slow
def test_steps_lead_where_a_run_does() -> None:
    _, scans = block_drive()
    run = Slam(CONFIG).solve(scans, Context(CONFIG, scans.revolution_s, scans.start_us, None))
    factors = psi_factors(scans, A, config=CONFIG, submap_keys=B)
    graph = gtsam.NonlinearFactorGraph()
    graph.push_back(prior(A(0), np.zeros(3)))
    for factor, _ in factors:
        graph.push_back(factor)
    values = gtsam.LevenbergMarquardtOptimizer(graph, factors.make_initial()).optimize()
    loops = loop_factors(scans, values, A, graph=graph, config=CONFIG)
    assert len(loops) > 5
    assert [(a.earlier, a.later) for _, a in loops] == [(b.earlier, b.later) for b in run.loops]
    np.testing.assert_allclose([a.pose for _, a in loops], [b.pose for b in run.loops], atol=1e-4)
    refined = refine(graph, values, scans, A, loops=loops, config=CONFIG)
    known = {(tie.earlier, tie.later) for tie in run.refined.ties}
    assert len({(tie.earlier, tie.later) for _, tie in refined.ties} ^ known) <= 0.05 * len(known)
    assert refined.psi_after == pytest.approx(run.refined.psi_across, rel=0.01)
    np.testing.assert_allclose(poses_of(refined.values, len(scans), A), run.optimised.poses, atol=0.01)
