from __future__ import annotations

from itertools import product

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from support.clouds import TURN_S, Cloud, cloud, selection, with_duplicates
from support.score_reference import score_reference

from mqslam.config import PsiConfig
from mqslam.core import se2
from mqslam.core.motion import CONSTANT_VELOCITY
from mqslam.core.scans import Returns
from mqslam.psi.neighbours import find_candidates, sort_into_cells
from mqslam.psi.place import Beam, place
from mqslam.psi.published.equations import PsiScore, score

VARIANTS = [
    PsiConfig(temporal=temporal, numerator=numerator, factor=factor, beta_t=0.15, unmatched=unmatched)
    for temporal, numerator, factor, unmatched in product(
        ("plateau", "gaussian"), ("tau/2", "tau"), ("distance", "kappa"), (0.0, 1.0)
    )
]
variants = st.sampled_from(VARIANTS)
seeds = st.integers(0, 2**32 - 1)
counts = st.integers(0, 40)
sides = st.sampled_from([1.0, 5.0, 30.0])  # from every point near every other to hardly any neighbour at all
angles = st.floats(-7.0, 7.0)
shifts = st.floats(-1000.0, 1000.0)


def scored(sample: Cloud, config: PsiConfig) -> PsiScore:
    return score(sample.points, sample.times, TURN_S, config, sample.jacobians)


def assert_equal(one: PsiScore, other: PsiScore, rtol: float = 1e-9) -> None:
    assert one.pairs == other.pairs
    np.testing.assert_array_equal(one.matched, other.matched)
    np.testing.assert_allclose(one.shares, other.shares, rtol=rtol, atol=1e-300)
    for name in ("psi", "pairs_psi", "charge"):
        assert getattr(one, name) == pytest.approx(getattr(other, name), rel=rtol)
    size = max(1.0, np.abs(other.gradient).max(initial=0.0), other.pairs_psi)
    np.testing.assert_allclose(one.gradient, other.gradient, rtol=rtol, atol=rtol * size)


@given(seed=seeds, count=counts, side=sides, config=variants, repeat=st.booleans())
@settings(max_examples=250, deadline=None)
def test_the_kernel_equals_the_reference(seed: int, count: int, side: float, config: PsiConfig, repeat: bool) -> None:
    sample = cloud(seed, count, side)
    if repeat:
        sample = with_duplicates(sample, seed)
    reference = score_reference(sample.points, sample.times, TURN_S, config, sample.jacobians)
    assert_equal(scored(sample, config), reference)
    plain = score(sample.points, sample.times, TURN_S, config)
    assert plain.psi == pytest.approx(reference.psi, rel=1e-9)
    assert plain.gradient.shape == (0,)


@pytest.mark.parametrize("config", VARIANTS)
def test_every_variant_equals_the_reference_where_pairs_abound(config: PsiConfig) -> None:
    sample = with_duplicates(cloud(3, 60, 4.0), 3)
    result = scored(sample, config)
    assert result.pairs > 100
    assert_equal(result, score_reference(sample.points, sample.times, TURN_S, config, sample.jacobians))


def test_every_variant_is_a_score_of_its_own() -> None:
    sample = cloud(3, 60, 4.0)
    matched = [scored(sample, config).pairs_psi for config in VARIANTS if config.unmatched == 0.0]
    assert len({round(psi, 9) for psi in matched}) == len(matched)


@pytest.mark.parametrize("count", [0, 1])
@pytest.mark.parametrize("config", [PsiConfig(unmatched=0.0), PsiConfig(unmatched=1.0)])
def test_nothing_and_a_single_point_have_no_pairs(count: int, config: PsiConfig) -> None:
    sample = cloud(1, count)
    result = scored(sample, config)
    assert_equal(result, score_reference(sample.points, sample.times, TURN_S, config, sample.jacobians))
    assert (result.pairs, result.pairs_psi, result.psi) == (0, 0.0, count * config.charge)
    assert not result.matched.any()
    np.testing.assert_array_equal(result.gradient, np.zeros(3))


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("scorer", [score, score_reference])
def test_what_is_not_finite_is_refused(scorer: object, bad: float) -> None:
    assert callable(scorer)
    for where in ("points", "times"):
        sample = cloud(1, 5)
        getattr(sample, where)[2, ...] = bad
        with pytest.raises(ValueError, match="finite"):
            scorer(sample.points, sample.times, TURN_S, PsiConfig())


@pytest.mark.parametrize(("points", "times"), [((5, 3), (5,)), ((5,), (5,)), ((5, 2), (4,)), ((5, 2), (5, 1))])
def test_shapes_that_do_not_fit_are_refused(points: tuple[int, ...], times: tuple[int, ...]) -> None:
    with pytest.raises(ValueError, match=r"\(N, 2\) and \(N,\)"):
        score(np.zeros(points), np.zeros(times), TURN_S, PsiConfig())


@given(seed=seeds, count=counts, config=variants, x=shifts, y=shifts, yaw=angles, late=shifts)
@settings(max_examples=150, deadline=None)
def test_psi_does_not_see_where_the_map_lies_nor_when_it_was_made(
    seed: int, count: int, config: PsiConfig, x: float, y: float, yaw: float, late: float
) -> None:
    sample = cloud(seed, count)
    assume(selection(sample.points, sample.times, config).margin > 1e-6)
    before = scored(sample, config)
    moved = score(se2.transform([x, y, yaw], sample.points), sample.times + late, TURN_S, config)
    assert moved.pairs == before.pairs
    np.testing.assert_allclose(moved.shares, before.shares, rtol=1e-6)
    assert moved.psi == pytest.approx(before.psi, rel=1e-6)


def window(seed: int, count: int) -> Returns:
    """Returns of one world seen in three scans while standing, rendered under a motion by the test."""
    rng = np.random.default_rng(seed)
    world = np.repeat(rng.uniform([3.0, -np.pi], [12.0, np.pi], (count, 2)), 3, axis=0)
    turns = np.tile(np.arange(3), count)
    times = TURN_S * (turns + (world[:, 1] + np.pi) / (2.0 * np.pi))
    ranges, azimuths = world[:, 0] + rng.normal(0.0, 0.05, 3 * count), np.ascontiguousarray(world[:, 1])
    return Returns(ranges, azimuths, times, np.full(3 * count, 100.0))


@given(
    seed=seeds,
    count=st.integers(1, 12),
    config=variants,
    v=st.floats(-1.0, 1.0),
    omega=st.floats(-0.1, 0.1),
)
@settings(max_examples=150, deadline=None)
def test_the_gradient_is_that_of_finite_differences_away_from_switches(
    seed: int, count: int, config: PsiConfig, v: float, omega: float
) -> None:
    returns, theta, step = window(seed, count), np.array([v, omega]), 1e-6

    def rendered(at: np.ndarray) -> Cloud:
        placed = place(returns, 0.0, np.zeros(3), at, CONSTANT_VELOCITY, Beam(0.1, 0.01))
        return Cloud(placed.points, placed.times, np.ascontiguousarray(placed.jacobians[:, :, 3:]))

    here = rendered(theta)
    chosen = selection(here.points, here.times, config)
    assume(chosen.pairs.any() and chosen.margin > 3e-4)  # the steps move a point by some micrometres
    gradient = scored(here, config).gradient
    for p in range(2):
        around = [rendered(theta + steps * step * np.eye(2)[p]) for steps in (-2.0, -1.0, 1.0, 2.0)]
        assume(all(selection(c.points, c.times, config).same_as(chosen) for c in around))
        far_behind, behind, ahead, far_ahead = (scored(c, config).psi for c in around)
        difference = (8.0 * (ahead - behind) - (far_ahead - far_behind)) / (12.0 * step)
        scale = np.abs(gradient).max() + scored(here, config).psi
        assert gradient[p] == pytest.approx(difference, rel=1e-5, abs=1e-7 * scale)


@pytest.mark.parametrize("unmatched", [0.0, 1.0, 2.5])
def test_an_unmatched_point_costs_its_multiple_of_the_dearest_pair(unmatched: float) -> None:
    config = PsiConfig(s=1.5, tau=0.4, unmatched=unmatched)
    pair = np.array([[0.0, 0.0], [1e-9 - 1.5, 0.0]])  # as far apart as a pair can be
    dearest = score(pair, np.array([0.0, TURN_S]), TURN_S, config.model_copy(update={"beta_s": 100.0}))
    assert dearest.matched.all()
    lone = score(np.array([[0.0, 0.0], [50.0, 0.0]]), np.array([0.0, TURN_S]), TURN_S, config)
    np.testing.assert_allclose(lone.shares, unmatched * dearest.shares, rtol=1e-6)
    assert lone.charge == pytest.approx(lone.shares.sum())
    assert lone.charge == pytest.approx(2.0 * unmatched * (2.0 * 1.5 / (np.pi * 0.4)) ** 2)


def test_as_printed_a_map_that_does_not_overlap_is_the_best_of_all_and_with_the_charge_the_worst() -> None:
    rng = np.random.default_rng(5)
    world = rng.uniform(-20.0, 20.0, (30, 2))
    times = np.repeat([0.0, TURN_S], 30)

    def maps(config: PsiConfig) -> tuple[float, float, float]:
        crisp, blurred, apart = (np.r_[world, world + np.array([dx, 0.0])] for dx in (0.05, 0.5, 500.0))
        return tuple(score(points, times, TURN_S, config).psi for points in (crisp, blurred, apart))  # type: ignore

    crisp, blurred, apart = maps(PsiConfig(unmatched=0.0))
    assert apart == 0.0 < crisp < blurred
    crisp, blurred, apart = maps(PsiConfig(unmatched=1.0))
    assert crisp < blurred < apart


@given(seed=seeds, count=counts, config=variants, more=st.floats(0.0, 5.0), repeat=st.booleans())
@settings(max_examples=100, deadline=None)
def test_lists_that_hold_more_than_needed_give_the_same_score(
    seed: int, count: int, config: PsiConfig, more: float, repeat: bool
) -> None:
    sample = cloud(seed, count)
    if repeat:
        sample = with_duplicates(sample, seed)
    lists = find_candidates(sort_into_cells(sample.points, 1.0), sample.points, config.s + more)
    wide = score(sample.points, sample.times, TURN_S, config, sample.jacobians, lists)
    assert_equal(wide, scored(sample, config), rtol=1e-12)
