"""Whatever returns a recording holds, and wherever a trajectory puts them: numbers that are finite, or one clear error."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from support.hard_recordings import assert_sound, joined, solve, stamps_of

from mqslam.auditing.judge import audit
from mqslam.auditing.sweeps import place_sweeps
from mqslam.backend.loops.registration import align
from mqslam.config import Config
from mqslam.core import se2
from mqslam.core.scans import Returns, Scan
from mqslam.core.trajectory import Trajectory
from mqslam.errors import EstimationError
from mqslam.execution.local_engine import HERE
from mqslam.execution.progress import ignore_progress
from mqslam.mapping.render import place_along, render
from mqslam.psi.place import beam_of
from mqslam.psi.score import make_references

TURN_S = 0.25
CONFIG = Config()
BEAM = beam_of(CONFIG.estimator, 0.0)
HARDLY_ANY = settings(
    derandomize=True, deadline=None, max_examples=25, database=None, suppress_health_check=list(HealthCheck)
)

ranges_m = st.one_of(st.sampled_from([0.0, 2.5, 10.0, 10.001, 150.0, 1e4]), st.floats(0.0, 200.0))
shares = st.one_of(st.sampled_from([0.0, 0.25, 0.5, 0.75, 0.999]), st.floats(0.0, 0.999))  # of a turn


@st.composite
def single_scans(draw: st.DrawFn, t0: float = 0.0) -> Scan:
    """Draws a scan with a few returns, some of them at one place."""
    seen = sorted(draw(st.lists(st.tuples(shares, ranges_m), max_size=40)))
    turn, r = np.array([share for share, _ in seen]), np.array([value for _, value in seen])
    returns = Returns(r, -2.0 * np.pi * turn, t0 + TURN_S * turn, np.full(len(seen), 100.0))
    return Scan(t0, t0 + TURN_S, returns)


@st.composite
def recordings(draw: st.DrawFn) -> list[Scan]:
    """Draws two to eight scans, with gaps between some."""
    starts = np.cumsum(draw(st.lists(st.sampled_from([1, 1, 1, 2, 9, 400]), min_size=2, max_size=8)))
    alike = draw(st.booleans())
    first = draw(single_scans())
    scans = []
    for start in (starts * TURN_S).tolist():
        scan = draw(single_scans(start))
        r = first.returns
        again = Returns(r.ranges, r.azimuths, r.times + start, r.intensities)
        scans.append(Scan(start, start + TURN_S, again) if alike else scan)
    return scans


@st.composite
def tracks(draw: st.DrawFn, size: int) -> se2.Array:
    """Draws poses of any kind: at rest, scattered, one of them on another continent."""
    steps = st.one_of(st.just(0.0), st.floats(-10.0, 10.0), st.sampled_from([1e4, 1e9]))
    return np.array(draw(st.lists(st.tuples(steps, steps, st.floats(-4.0, 4.0)), min_size=size, max_size=size)))


@pytest.mark.parametrize("frontend", ["kiss_icp", "open3d_icp"])
@HARDLY_ANY
@given(scans=recordings())
def test_a_scan_matcher_solves_soundly_or_refuses(frontend: str, scans: list[Scan]) -> None:
    try:
        assert_sound(solve(scans, frontend))
    except EstimationError as error:
        assert "returns in" in str(error)


@HARDLY_ANY
@given(scans=recordings())
def test_psi_solves_soundly_or_refuses(scans: list[Scan]) -> None:
    try:
        assert_sound(solve(scans, "psi", doppler_beta=None))
    except EstimationError as error:
        assert "returns in" in str(error)


@pytest.mark.filterwarnings("error::RuntimeWarning")
@HARDLY_ANY
@given(data=st.data(), scans=recordings())
def test_any_returns_are_rendered_and_audited_under_any_trajectory(data: st.DataObject, scans: list[Scan]) -> None:
    poses = data.draw(tracks(len(scans)))
    track = Trajectory(stamps_of(scans), poses)
    try:
        pointmap = render(joined(scans), poses, CONFIG.estimator, BEAM)
        sweeps, _ = place_sweeps(joined(scans), track, BEAM)
    except EstimationError as error:
        assert "returns in" in str(error)
        return
    assert np.isfinite(pointmap.psi).all()
    result = audit(sweeps, CONFIG, HERE, ignore_progress)
    for window in result.windows:
        assert np.isfinite([window.bend.inflation, window.bend.psi, window.bend.psi_best]).all()
        np.testing.assert_array_less(0.0, np.diag(window.bend.covariance))


@pytest.mark.filterwarnings("error::RuntimeWarning")
@HARDLY_ANY
@given(reference=single_scans(), query=single_scans())
def test_any_two_submaps_are_aligned(reference: Scan, query: Scan) -> None:
    if not len(reference.returns) or not len(query.returns):
        return
    one, other = (place_along(w.returns, np.zeros(1), np.zeros((1, 3)), BEAM) for w in (reference, query))
    result = align(make_references(one), other, np.zeros(3), (3.0, 0.05), CONFIG.estimator)
    assert np.isfinite(result.pose).all()
    assert np.isfinite(result.covariance).all()
    assert result.observed in (True, False)
