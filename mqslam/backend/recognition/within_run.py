"""The loops of a run: found around its trajectory, and by what places look like where that search does not reach."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mqslam.backend.loops import passes
from mqslam.backend.loops.candidates import GATE_M, compute_reach, is_beyond_gate, may_meet
from mqslam.backend.loops.chain import Chain, compute_layouts
from mqslam.backend.loops.closing import ROUNDS, LoopCloser, Recognised
from mqslam.backend.loops.submap import TrackedRun
from mqslam.backend.problem import GraphProblem
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


def find_loops(
    scans: Scans,
    problem: GraphProblem,
    estimator: EstimatorConfig,
    beam: Beam,
    runner: Runner,
    *,
    recognising: bool = True,
) -> LoopSearch:
    """Returns the loops that psi verifies, that the trajectory allows, that agree and that make the map better.

    Where the trajectory stays too unsure for the search around it to reach all that it allows, places are recognised by
    what they look like. Their loops are verified alike, and the search around the trajectory that they correct goes on.

    Args:
        scans: of the recording.
        problem: the trajectory that the loops join.
        estimator: settings of the score.
        beam: the sensor's errors.
        runner: does the work.
        recognising: whether places are recognised which the search around the trajectory does not reach.

    Raises:
        EstimationError: the uncertainty of the trajectory cannot be computed.
    """
    closer = LoopCloser(problem, lambda poses: TrackedRun.of(scans, poses), estimator, beam, runner)
    if not recognising:
        closer.look_around()
        return closer.conclude()
    for _ in range(ROUNDS):
        if not closer.look_around(_is_out_of_reach):
            return closer.conclude()
        if not closer.look_everywhere(lambda chain: _recognise(chain, estimator, beam, runner.engine)):
            return closer.conclude()
    closer.look_around()
    return closer.conclude()


def find_out_of_reach(chain: Chain, places: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Finds the earlier places that each place of a drive may be, as far as its trajectory can tell.

    Only a place is asked about for which the search around the trajectory does not reach to one of these. The trajectory is
    asked at scans GATE_M apart, and at none beyond the first one where it knows all of them well enough against that.

    Args:
        chain: the trajectory, with its uncertainty.
        places: (P,) numbers of scans, increasing.

    Returns:
        (P, P) whether the place of a row may be the earlier place of a column; rows without any where the search reaches.

    Raises:
        EstimationError: the uncertainty of the trajectory cannot be computed.
    """
    travelled = chain.drive.travelled
    nodes = pick_spaced(travelled, GATE_M)
    pairs = [(int(nodes[0]), int(b)) for b in nodes[1:]]
    if not any(is_beyond_gate(*compute_reach(relative)) for relative in chain.relate(pairs)):
        return np.zeros((len(places), len(places)), dtype=bool)
    later, earlier = np.tril_indices(len(nodes), -1)
    apart = travelled[nodes[later]] - travelled[nodes[earlier]] > passes.LEAST_PATH_M
    later, earlier = later[apart], earlier[apart]
    pairs = list(zip(nodes[earlier].tolist(), nodes[later].tolist(), strict=True))
    recognition = np.zeros((len(nodes), len(nodes)), dtype=np.bool_)
    unsure = recognition.copy()
    for a, b, relative in zip(earlier, later, chain.relate(pairs), strict=True):
        # the places of a node lie up to GATE_M farther along the path
        recognition[b, a] = may_meet(relative, GATE_M)
        unsure[b, a] = recognition[b, a] and is_beyond_gate(*compute_reach(relative))
    recognition &= np.asarray(unsure.any(axis=1))[:, None]
    node = np.maximum(np.searchsorted(nodes, places, side="right") - 1, 0)
    allowed: NDArray[np.bool_] = recognition[np.ix_(node, node)]
    return np.asarray(allowed & (travelled[places][:, None] - travelled[places][None, :] > passes.LEAST_PATH_M))


def _is_out_of_reach(chain: Chain) -> bool:
    """Returns whether a trajectory allows that there are places which the search around it does not reach."""
    return bool(find_out_of_reach(chain, pick_spaced(chain.drive.travelled, PLACE_SPACING_M)).any())


def _recognise(chain: Chain, estimator: EstimatorConfig, beam: Beam, engine: Engine) -> Recognised:
    """Returns loops of places that the search around a trajectory does not reach."""
    places = pick_spaced(chain.drive.travelled, PLACE_SPACING_M)
    allowed = find_out_of_reach(chain, places)
    asked = allowed.any(axis=1)
    if not asked.any():
        return Recognised([], 0, 0)
    table = describe_places(chain.drive, beam, engine)
    ground = Ground(chain.drive, table.keyframes, PlaceIndex(table.descriptors))
    found = recognise(chain.drive, places[asked], ground, allowed[asked], estimator, beam, engine)
    matches = [match for row in found.rows for match in row]
    layouts = compute_layouts(chain, [(match.place, match.query) for match in matches])
    loops = [
        Loop(m.place, m.query, m.pose, layout.widen(m.pose, m.covariance), m.matched, m.psi)
        for m, layout in zip(matches, layouts, strict=True)
    ]
    return Recognised(loops, found.compared, len(found.ambiguous))
