"""Recognition within a run: loops of places that the search around the trajectory does not reach."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mqslam.backend.loops.chain import Chain
from mqslam.backend.loops.closing import Recognised, close_loops
from mqslam.backend.loops.layout import compute_layouts
from mqslam.backend.problem import GraphProblem
from mqslam.backend.recognition.out_of_reach import find_out_of_reach
from mqslam.backend.recognition.place_index import PlaceIndex
from mqslam.backend.recognition.places import PLACE_SPACING_M, describe_places
from mqslam.backend.recognition.recognise import Ground, recognise
from mqslam.config import EstimatorConfig
from mqslam.core.engine import Engine
from mqslam.core.measurement import Loop, LoopSearch
from mqslam.core.scans import Scans
from mqslam.execution.runner import Runner
from mqslam.mapping.keyframing import pick_spaced
from mqslam.psi.place import Beam


def find_loops(scans: Scans, problem: GraphProblem, estimator: EstimatorConfig, beam: Beam, runner: Runner) -> LoopSearch:
    """Returns the loops of a run: found around its trajectory and, where that is too unsure, by what places look like.

    Args:
        scans: of the recording.
        problem: the trajectory that the loops join.
        estimator: settings of the score.
        beam: the sensor's errors.
        runner: does the work.

    Raises:
        EstimationError: the uncertainty of the trajectory cannot be computed.
    """
    recogniser = RunRecogniser(estimator, beam, runner.engine)
    return close_loops(scans, problem, estimator, beam, runner, recogniser)


@dataclass(frozen=True, slots=True)
class RunRecogniser:
    """Recognises earlier places of a drive where its trajectory is too unsure for a search around it to reach them.

    Args:
        estimator: settings of the score.
        beam: the sensor's errors.
        engine: where submaps are compared; the result does not depend on it.
    """

    estimator: EstimatorConfig
    beam: Beam
    engine: Engine

    def is_needed(self, chain: Chain) -> bool:
        """Returns whether a trajectory allows that there are such places.

        Raises:
            EstimationError: the uncertainty of the trajectory cannot be computed.
        """
        return bool(find_out_of_reach(chain, _pick_places(chain)).any())

    def recognise(self, chain: Chain) -> Recognised:
        """Recognises such places.

        Raises:
            EstimationError: the uncertainty of the trajectory cannot be computed.
        """
        places = _pick_places(chain)
        allowed = find_out_of_reach(chain, places)
        asked = allowed.any(axis=1)
        if not asked.any():
            return Recognised([], 0, 0)
        table = describe_places(chain.drive, self.beam, self.engine)
        ground = Ground(chain.drive, table.keyframes, PlaceIndex(table.descriptors))
        found = recognise(chain.drive, places[asked], ground, allowed[asked], self.estimator, self.beam, self.engine)
        matches = [match for row in found.rows for match in row]
        layouts = compute_layouts(chain, [(match.place, match.query) for match in matches])
        loops = [
            Loop(m.place, m.query, m.pose, layout.widen(m.pose, m.covariance), m.matched, m.psi)
            for m, layout in zip(matches, layouts, strict=True)
        ]
        return Recognised(loops, found.compared, len(found.ambiguous))


def _pick_places(chain: Chain) -> NDArray[np.int64]:
    return pick_spaced(chain.drive.travelled, PLACE_SPACING_M)
