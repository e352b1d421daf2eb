"""Loop closure in rounds: every round searches around the trajectory that the loops found before have corrected."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from typing import NamedTuple, Protocol

from mqslam.backend.loops import passes
from mqslam.backend.loops.candidates import find_candidates
from mqslam.backend.loops.chain import Chain
from mqslam.backend.loops.consistency import LARGEST_CHI_SQUARE, as_relative, compute_chi_square, keep_consistent
from mqslam.backend.loops.search import compare_passes, confirm_by_map
from mqslam.backend.loops.submap import Drive, Passes
from mqslam.backend.problem import GraphProblem
from mqslam.config import EstimatorConfig
from mqslam.core.measurement import Loop, LoopSearch
from mqslam.core.scans import Scans
from mqslam.execution.runner import Runner
from mqslam.psi.place import Beam

# Number of searches; each starts from the trajectory that the loops found before have corrected.
_ROUNDS = 2

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


class Recogniser(Protocol):
    """Recognises places of a drive which the search around its trajectory does not reach."""

    def is_needed(self, chain: Chain) -> bool:
        """Returns whether a trajectory allows that there are such places."""

    def recognise(self, chain: Chain) -> Recognised:
        """Recognises them."""


def close_loops(
    scans: Scans,
    problem: GraphProblem,
    estimator: EstimatorConfig,
    beam: Beam,
    runner: Runner,
    recogniser: Recogniser | None = None,
) -> LoopSearch:
    """Returns the loops that psi verifies, that the trajectory allows, that agree and that make the map better.

    Where the trajectory stays too unsure for the search around it to reach all that it allows, places are recognised by
    what they look like. Their loops are verified alike, and the search around the trajectory that they correct goes on.

    Args:
        scans: scans of the recording.
        problem: the trajectory that the loops join.
        estimator: settings of the estimator.
        beam: the sensor model.
        runner: does the work.
        recogniser: recognises places which the search around the trajectory does not reach; None does without.

    Raises:
        EstimationError: the uncertainty of the trajectory cannot be computed.
    """
    search = _Search(scans, problem, estimator, beam, runner, recogniser)
    for _ in range(_ROUNDS):
        if not (search.look_around() and search.look_everywhere()):
            return search.conclude()
    search.look_around()
    return search.conclude()


class _Search:
    """A search for loops: those found so far, and what has been compared. The arguments are those of `close_loops`."""

    def __init__(
        self,
        scans: Scans,
        problem: GraphProblem,
        estimator: EstimatorConfig,
        beam: Beam,
        runner: Runner,
        recogniser: Recogniser | None,
    ) -> None:
        self._scans, self._problem, self._estimator, self._beam, self._runner = scans, problem, estimator, beam, runner
        self._recogniser = recogniser
        self._loops: list[Loop] = []
        self._compared: set[tuple[int, int]] = set()
        self._decided: set[tuple[int, int]] = set()
        self._implausible: set[tuple[int, int]] = set()
        self._ambiguous = self._unsure = 0
        self._recognised = self._alike = self._elsewhere = 0  # counts of the recognition
        self._before: Passes | None = None

    def look_around(self) -> bool:
        """Looks in rounds for passes around where the trajectory has them; returns whether that does not reach all."""
        out_of_reach = False
        for number in range(_ROUNDS):
            chain = self._optimise()
            new = self._compare(chain)
            if self._recogniser is not None and (not new or number == _ROUNDS - 1):
                out_of_reach = self._recogniser.is_needed(chain)
            if not new:
                break
            kept = keep_consistent(new, chain, passes.LEAST_PATH_M)
            del chain  # what it has eliminated takes more memory than anything else here
            self._join(kept)
        return out_of_reach

    def look_everywhere(self) -> bool:
        """Recognises places, and returns whether any loop has come of it."""
        assert self._recogniser is not None
        chain = self._optimise()
        found = self._recogniser.recognise(chain)
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
        before = {(loop.earlier, loop.later) for loop in self._loops}
        self._join([loop for loop in kept if (loop.earlier, loop.later) not in before])
        added = {(loop.earlier, loop.later) for loop in self._loops} - before
        self._decided |= added
        _log.info("%d loops by recognition of places, %d places look like several", len(added), found.ambiguous)
        return bool(added)

    def conclude(self) -> LoopSearch:
        """Returns what the search has led to."""
        ambiguous, implausible = self._ambiguous + self._alike, len(self._implausible) + self._elsewhere
        tried = len(self._compared) + self._recognised
        _log.info("%d of %d pairs of passes are loops that the map keeps", len(self._loops), tried)
        _log.info("%d pairs match at several places, %d at an implausible one", ambiguous, implausible)
        return LoopSearch(self._loops, tried, ambiguous, implausible, self._unsure)

    def _compare(self, chain: Chain) -> list[Loop]:
        """Returns the new loops around a trajectory that psi verifies and the trajectory allows."""
        runner = self._runner
        candidates, unsure = find_candidates(chain, self._decided)
        comparisons = compare_passes(chain.drive, candidates, self._estimator, self._beam, runner.engine, runner.progress)
        self._implausible = {c[:2] for c, comparison in zip(candidates, comparisons, strict=True) if comparison.implausible}
        self._compared |= {c[:2] for c in candidates}
        # a trajectory that loops have corrected may allow the others
        self._decided |= {c[:2] for c in candidates} - self._implausible
        self._ambiguous += sum(comparison.ambiguous for comparison in comparisons)
        self._unsure = len(unsure)
        return [comparison.loop for comparison in comparisons if comparison.loop is not None]

    def _join(self, new: Sequence[Loop]) -> None:
        """Lets new loops join, and drops those that make the map worse."""
        loops, before = [*self._loops, *new], self._before
        assert before is not None  # the trajectory has been optimised
        after = self._problem.solve_poses(loops)
        engine = self._runner.engine
        self._loops = confirm_by_map(loops, before, after, self._estimator, self._beam, engine)

    def _optimise(self) -> Chain:
        """Returns the optimised trajectory with the loops found so far."""
        graph, optimum = self._problem.optimise(self._loops)
        chain = Chain(Drive.of(self._scans, graph.poses_at(optimum.values)), graph, optimum.values)
        self._before = chain.drive if self._before is None else self._before
        return chain
