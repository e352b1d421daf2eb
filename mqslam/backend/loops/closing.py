"""Loop closure in rounds: every round searches around the trajectory that the loops found before have corrected."""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mqslam.backend.loops import passes
from mqslam.backend.loops.candidates import find_candidates
from mqslam.backend.loops.chain import Chain
from mqslam.backend.loops.consistency import LARGEST_CHI_SQUARE, as_relative, compute_chi_square, keep_consistent
from mqslam.backend.loops.search import compare_passes, confirm_by_map
from mqslam.backend.loops.submap import Passes
from mqslam.backend.problem import GraphProblem
from mqslam.config import EstimatorConfig
from mqslam.core import se2
from mqslam.core.measurement import Loop, LoopSearch
from mqslam.execution.runner import Runner
from mqslam.psi.place import Beam

ROUNDS = 2
"""Number of searches; each starts from the trajectory that the loops found before have corrected."""

_log = logging.getLogger(__name__)


class Recognised(NamedTuple):
    """What a search has found that needs no guess of where a place is.

    Args:
        loops: the loops that psi verifies.
        compared: number of pairs of scans that psi has compared.
        ambiguous: number of scans that match several places.
    """

    loops: list[Loop]
    compared: int
    ambiguous: int


class LoopCloser:
    """Finds the loops that psi verifies, that the trajectory allows, that agree and that make the map better.

    Args:
        problem: the trajectory that the loops join.
        place: returns the scans under poses (N, 3) of the trajectory.
        estimator: settings of the score.
        beam: the sensor's errors.
        runner: does the work.
        before: scans under the trajectory before any loop; None takes the optimum without loops.
        groups: (N,) group of each scan, if only loops between different groups are wanted.

    Attributes:
        loops: those that have joined the trajectory.
    """

    def __init__(
        self,
        problem: GraphProblem,
        place: Callable[[se2.Array], Passes],
        estimator: EstimatorConfig,
        beam: Beam,
        runner: Runner,
        before: Passes | None = None,
        groups: NDArray[np.int64] | None = None,
    ) -> None:
        self._problem, self._place, self._estimator, self._beam, self._runner = problem, place, estimator, beam, runner
        self._before, self._groups = before, groups
        self.loops: list[Loop] = []
        self._compared: set[tuple[int, int]] = set()
        self._decided: set[tuple[int, int]] = set()
        self._implausible: set[tuple[int, int]] = set()
        self._ambiguous = self._unsure = 0
        self._recognised = self._alike = self._elsewhere = 0  # counts of the recognition

    def look_around(self, is_needed: Callable[[Chain], bool] | None = None) -> bool:
        """Looks in rounds for passes around where the trajectory has them.

        Args:
            is_needed: returns whether a trajectory allows passes that this search does not reach.

        Returns:
            Whether the trajectory of the last round allows such passes.

        Raises:
            EstimationError: the uncertainty of the trajectory cannot be computed.
        """
        out_of_reach = False
        for number in range(ROUNDS):
            chain = self._optimise()
            new = self._compare(chain)
            if is_needed is not None and (not new or number == ROUNDS - 1):
                out_of_reach = is_needed(chain)
            if not new:
                break
            kept = keep_consistent(new, chain, passes.LEAST_PATH_M)
            del chain  # what it has eliminated takes more memory than anything else here
            self.join(kept)
        return out_of_reach

    def look_everywhere(self, recognise: Callable[[Chain], Recognised]) -> bool:
        """Takes loops that need no guess of where a place is, and returns whether any of them has joined.

        Args:
            recognise: returns such loops of a trajectory.

        Raises:
            EstimationError: the uncertainty of the trajectory cannot be computed.
        """
        chain = self._optimise()
        found = recognise(chain)
        if not found.compared:
            return False
        relatives = chain.relate([(loop.earlier, loop.later) for loop in found.loops])
        plausible = [
            loop
            for loop, relative in zip(found.loops, relatives, strict=True)
            if compute_chi_square(relative, as_relative(loop)) <= LARGEST_CHI_SQUARE
        ]
        self._recognised += found.compared
        self._alike, self._elsewhere = found.ambiguous, len(found.loops) - len(plausible)
        kept = keep_consistent(plausible, chain, passes.LEAST_PATH_M)
        del chain
        before = {(loop.earlier, loop.later) for loop in self.loops}
        self.join([loop for loop in kept if (loop.earlier, loop.later) not in before])
        added = {(loop.earlier, loop.later) for loop in self.loops} - before
        self._decided |= added
        _log.info("%d loops by recognition of places, %d places look like several", len(added), found.ambiguous)
        return bool(added)

    def start_from(self, first: Sequence[Loop]) -> None:
        """Lets loops join that are known before the search; their pairs of scans are not compared again."""
        self._decided = {(loop.earlier, loop.later) for loop in first}
        self.join(first)

    def join(self, new: Sequence[Loop]) -> None:
        """Lets new loops join, and drops those that make the map worse."""
        loops, before = [*self.loops, *new], self._before
        assert before is not None  # it was given, or the trajectory has been optimised
        after = self._problem.solve_poses(loops)
        self.loops = confirm_by_map(loops, before, after, self._estimator, self._beam, self._runner.engine)

    def conclude(self) -> LoopSearch:
        """Returns what the search has led to."""
        ambiguous, implausible = self._ambiguous + self._alike, len(self._implausible) + self._elsewhere
        tried = len(self._compared) + self._recognised
        _log.info("%d of %d pairs of passes are loops that the map keeps", len(self.loops), tried)
        _log.info("%d pairs match at several places, %d at an implausible one", ambiguous, implausible)
        return LoopSearch(self.loops, tried, ambiguous, implausible, self._unsure)

    def _compare(self, chain: Chain) -> list[Loop]:
        """Returns the new loops around a trajectory that psi verifies and the trajectory allows."""
        runner = self._runner
        candidates, unsure = find_candidates(chain, self._decided, self._groups)
        comparisons = compare_passes(chain.drive, candidates, self._estimator, self._beam, runner.engine, runner.progress)
        self._implausible = {c[:2] for c, comparison in zip(candidates, comparisons, strict=True) if comparison.implausible}
        self._compared |= {c[:2] for c in candidates}
        # a trajectory that loops have corrected may allow the others
        self._decided |= {c[:2] for c in candidates} - self._implausible
        self._ambiguous += sum(comparison.ambiguous for comparison in comparisons)
        self._unsure = len(unsure)
        return [comparison.loop for comparison in comparisons if comparison.loop is not None]

    def _optimise(self) -> Chain:
        """Returns the optimised trajectory with the loops found so far."""
        graph, optimum = self._problem.optimise(self.loops)
        chain = Chain(self._place(graph.poses_at(optimum.values)), graph, optimum.values)
        self._before = chain.drive if self._before is None else self._before
        return chain
