"""Minimises psi by Newton steps on an annealed score: the widths of the score (`Scale`) shrink from step to step.

With wide widths the search finds the basin of the minimum, so the start need not be good. With narrow widths it finds the
bottom of the basin, and the result is not blurred by neighbours that belong to other objects. The Q variables of the state
are a pose, the parameters of a motion or both, as `render` of `minimise` takes them.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numba as nb
import numpy as np
from numba.extending import register_jitable
from numpy.typing import NDArray

from mqslam.config import EstimatorConfig
from mqslam.psi.neighbours import NearbyLists, do_serve, find_candidates, list_near, sort_into_cells
from mqslam.psi.place import PointSet
from mqslam.psi.score import Kernel, PsiEvaluation, References, Scale, evaluate, find_reach

# Width c of the score, in standard deviations of an offset, at the end of the annealing and at its start.
C, _C_START = 1.5, 5.0
# Width beta_t of the score [s].
BETA_T = 0.06
# Least kappa of a selected neighbour. A neighbour with a smaller kappa would hardly add to the score.
_XI = 0.02
# Factors for a neighbour that was seen from a quite different direction than the query: on its kappa and on its blur. If
# both are 1, all views count the same.
APART_SHARE, APART_BLUR = 0.3, 2.0
# Number of returns that count as one independent measurement. The curvature of psi is divided by this number where a prior
# is added to psi.
CORRELATION = 5.0
# Largest number of Newton steps.
STEPS = 12
# Factor by which the widths shrink from step to step.
_SHRINK = 0.6
# Difference of viewing directions [rad] at which the likeness of two views of an object has fallen to 1/e. On real radar,
# the returns of two views scatter by 0.15 m along the ray if the directions differ by less than 1 degree, and by 0.22 m if
# they differ by more than 12 degrees.
_ASPECT_RAD = 0.05

# Share of `PsiEvaluation.information` that is added to `PsiEvaluation.curvature`, so that no step goes too far.
STABILISER = 0.15

# Distances by which lists of neighbours reach farther than the score [m], for fixed references and for points that all move.
# They affect only speed.
SKIN_M, _MOVING_SKIN_M = 0.2, 0.3
_LARGEST_PART = 0.9  # largest assumed ratio of a step to the step before it, which keeps the extrapolation finite
_FLATTEST = 1e-9  # least curvature that a step is divided by [1/tolerance^2], which keeps the step finite


def annealed_scale(config: EstimatorConfig, step: int, share: float = 1.0) -> Scale:
    """Returns the widths at a step of the annealing: `share` times the first widths, shrunk `step` times.

    No width falls below its final width.
    """
    f = _SHRINK**step
    return Scale(
        max(config.s, share * config.s_start * f),
        max(config.beta_s, share * config.beta_s_start * f),
        max(C, share * _C_START * f),
    )


def final_scale(config: EstimatorConfig) -> Scale:
    """Returns the widths of the score at the end of the annealing."""
    return Scale(config.s, config.beta_s, C)


@dataclass(frozen=True, slots=True)
class Prior:
    """A Gaussian prior over the state.

    Args:
        mean: (Q,) the most likely state.
        information: (Q, Q) inverse of the prior's covariance.
    """

    mean: NDArray[np.float64]
    information: NDArray[np.float64]


class Search(NamedTuple):
    """The settings of the search for a minimum.

    Args:
        steps: largest number of Newton steps.
        first: step of the annealing that the search begins with; a good start needs no wide widths.
        settled: at the final widths, a step shorter than this many standard deviations of the state ends the search; with
            zero, only the tolerances end the search.
        foresees: whether each step at the final widths is extended to where the following steps would lead. Where psi is
            flat, such a search needs a prior, without which the state would drift away.
        share: factor on the first widths of the annealing.
        correlation: number of returns that count as one independent measurement; psi is divided by this number before the
            prior is added.
    """

    steps: int = STEPS
    first: int = 0
    settled: float = 0.0
    foresees: bool = False
    share: float = 1.0
    correlation: float = CORRELATION


@dataclass(frozen=True, slots=True)
class Minimum:
    """The result of the minimiser.

    Args:
        state: (Q,) the state at which the search ended.
        evaluation: the score at this state, at the final widths; before the last step if `Search.settled` ended the search.
        converged: whether the last step was shorter than the tolerances or than `Search.settled`.
    """

    state: NDArray[np.float64]
    evaluation: PsiEvaluation
    converged: bool


def kernel_of(config: EstimatorConfig, revolution_s: float) -> Kernel:
    """Returns the parameters of the score besides its widths, as the settings state them.

    Args:
        config: settings of the score.
        revolution_s: duration of a revolution of the radar [s]; with zero, times play no part.
    """
    return Kernel(revolution_s, BETA_T, _XI, config.blur_m, _ASPECT_RAD, APART_SHARE, APART_BLUR * config.blur_m)


class Expansion(NamedTuple):
    """The expansion of psi / 2 around a state, up to second order.

    Args:
        gradient: (Q,) gradient.
        information: (Q, Q) Gauss-Newton's curvature.
        curvature: (Q, Q) curvature that accounts for the re-selection of neighbours as points move, symmetric.
    """

    gradient: NDArray[np.float64]
    information: NDArray[np.float64]
    curvature: NDArray[np.float64]


def minimise(
    start: NDArray[np.float64],
    render: Callable[[NDArray[np.float64]], PointSet],
    references: References | None,
    prior: Prior,
    config: EstimatorConfig,
    kernel: Kernel,
    tolerances: NDArray[np.float64],
    search: Search | None = None,
) -> Minimum:
    """Minimises psi / (2 `search.correlation`) plus half the squared Mahalanobis distance from the prior's mean.

    Args:
        start: (Q,) state at which the search begins.
        render: returns the points of a state (Q,), in the frame of the references; their jacobians are (N, 2, Q).
        references: points that the rendered points are compared with; None compares the rendered points with each other.
        prior: Gaussian over the state.
        config: widths of the score.
        kernel: parameters of the score besides its widths.
        tolerances: (Q,) a step at the final widths that is smaller than this in every variable ends the search.
        search: settings of the search; None takes the defaults of `Search`, which begin at the widest widths.
    """
    search = search or Search()
    state, rendered = np.array(start, dtype=np.float64), Rendered(render, references, kernel)
    last, settled, converged = final_scale(config), False, False
    before: tuple[NDArray[np.float64], NDArray[np.float64]] | None = None
    for step in range(search.first, search.first + search.steps):
        scale = annealed_scale(config, step, search.share)
        here = rendered.evaluate(state, scale)
        around, beside = Expansion(here.gradient, here.information, here.curvature), state - prior.mean
        move, length = choose_move(around, beside, prior.information, search.correlation, tolerances)
        if scale == last:
            settled = length < search.settled
            converged = settled or bool(np.all(np.abs(move) < tolerances))
            if search.foresees:
                earlier, before = before, (state, move)
                if earlier is not None:
                    move = _extrapolate(move, move - earlier[1], state - earlier[0], tolerances)
        state = state + shorten_step(move, _measure_move(rendered.jacobians, move), scale.s)
        if settled:
            return Minimum(state, here, True)  # so short a step hardly changes the score
        if converged:
            break
    return Minimum(state, rendered.evaluate(state, last), converged)


class Rendered:
    """Renders and scores points at one state after another; `render`, `references` and `kernel` are as in `minimise`.

    Lists of neighbours are kept from state to state as long as no neighbour can be missing. The attribute `jacobians`
    (N, 2, Q) holds the derivatives of the points that were rendered last.
    """

    def __init__(
        self, render: Callable[[NDArray[np.float64]], PointSet], references: References | None, kernel: Kernel
    ) -> None:
        self._render, self._references, self._kernel = render, references, kernel
        self._lists: NearbyLists | None = None
        self.jacobians = np.empty((0, 2, 0))

    def evaluate(self, state: NDArray[np.float64], scale: Scale) -> PsiEvaluation:
        """Renders the points at a state (Q,) and returns their score at the given widths."""
        queries, reach = self._render(state), find_reach(scale, self._kernel)
        self.jacobians = queries.jacobians
        self._lists = renew_lists(self._lists, queries.points, self._references, reach)
        return evaluate(queries, self._references, scale, self._kernel, self._lists)


def renew_lists(
    lists: NearbyLists | None, points: NDArray[np.float64], references: References | None, reach: float
) -> NearbyLists:
    """Returns the given lists of neighbours if they hold all neighbours within a reach and few others, else new lists.

    Args:
        lists: lists that were made before; None if there are none.
        points: (N, 2) present positions of the points [m].
        references: points to list as neighbours; None lists the points themselves, all of which move.
        reach: distance within which neighbours are needed [m].
    """
    skin, moves = (_MOVING_SKIN_M, 2.0) if references is None else (SKIN_M, 1.0)
    if lists is not None and len(points) == len(lists.queries) and do_serve(lists, points, reach, skin, moves):
        return lists
    if references is None:
        new: NearbyLists = find_candidates(sort_into_cells(points, reach + skin), points, reach + skin)
    else:
        new = list_near(references.grid, points, reach + skin)
    return new


@register_jitable
def shorten_step(move: NDArray[np.float64], moved_m: float, reach_m: float) -> NDArray[np.float64]:
    """Shortens a step (Q,) that moves the points by `moved_m` (RMS, [m]), so that this RMS is at most `reach_m` [m].

    Otherwise a step could carry points past their neighbours. An infinite `moved_m` (no points) gives a step of zero.
    """
    return move if moved_m <= reach_m else move * (reach_m / moved_m)


@nb.njit(cache=True, nogil=True)
def _measure_move(jacobians: NDArray[np.float64], move: NDArray[np.float64]) -> float:
    """Returns the RMS distance [m] by which a step (Q,) moves points with jacobians (N, 2, Q); inf if N = 0."""
    total = 0.0
    for i in range(len(jacobians)):
        dx, dy = 0.0, 0.0
        for p in range(len(move)):
            dx += jacobians[i, 0, p] * move[p]
            dy += jacobians[i, 1, p] * move[p]
        total += dx * dx + dy * dy
    return float(np.sqrt(total / len(jacobians))) if len(jacobians) else np.inf


@nb.njit(cache=True, nogil=True)
def choose_move(
    here: Expansion,
    beside: NDArray[np.float64],
    information: NDArray[np.float64],
    correlation: float,
    tolerances: NDArray[np.float64],
) -> tuple[NDArray[np.float64], float]:
    """Returns Newton's step (Q,), and the step's length in units of the standard deviations that the curvature shows.

    The step goes downhill along every eigenvector of the curvature, whatever the sign of the eigenvalue. The eigenvalues are
    computed in units of the tolerances, so that metres and radians are comparable.

    Args:
        here: expansion of the score around the state.
        beside: (Q,) the state minus the prior's mean.
        information: (Q, Q) information of the prior.
        correlation: number by which the score is divided before the prior is added.
        tolerances: (Q,) units of the variables.
    """
    size = len(beside)
    gradient = np.empty(size)
    curvature = np.empty((size, size))
    for p in range(size):
        total = here.gradient[p] / correlation
        for r in range(size):
            total += information[p, r] * beside[r]
            bent = (here.curvature[p, r] + STABILISER * here.information[p, r]) / correlation + information[p, r]
            curvature[p, r] = bent * tolerances[p] * tolerances[r]
        gradient[p] = tolerances[p] * total
    values, vectors = np.linalg.eigh(curvature)
    move = np.zeros(size)
    squared = 0.0
    for k in range(size):
        along = 0.0
        for p in range(size):
            along += vectors[p, k] * gradient[p]
        steep = along
        along /= max(abs(values[k]), _FLATTEST)
        squared += steep * along
        for p in range(size):
            move[p] -= tolerances[p] * vectors[p, k] * along
    return move, float(np.sqrt(squared))


@nb.njit(cache=True, nogil=True)
def _extrapolate(
    move: NDArray[np.float64], changed: NDArray[np.float64], went: NDArray[np.float64], tolerances: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Returns the step (Q,) to where the search would end if each step were a constant multiple of the step before it.

    The step becomes longer if successive steps have the same sign, and shorter if their signs alternate. This helps because
    the terms that keep Newton's steps safe shorten all steps by nearly the same share. The method is Anderson's mixing of
    two steps (J. ACM 12, 1965).

    Args:
        move: (Q,) Newton's step.
        changed: (Q,) Newton's step minus the Newton's step before it.
        went: (Q,) change of the state between the two states at which these steps were computed.
        tolerances: (Q,) units of the variables.
    """
    above, below = 0.0, 0.0
    for p in range(len(move)):
        above += move[p] * changed[p] / tolerances[p] ** 2
        below += changed[p] ** 2 / tolerances[p] ** 2
    if below == 0.0:
        return move
    least, most = _LARGEST_PART / (_LARGEST_PART - 1.0), 0.5  # for ratios of successive steps from the largest to -1
    share = min(max(above / below, least), most)
    return move - share * (went + changed)
