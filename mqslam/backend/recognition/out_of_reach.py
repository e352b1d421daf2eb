"""Which places of a drive may be one place without the search around the trajectory reaching from one to the other."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mqslam.backend.loops import passes
from mqslam.backend.loops.candidates import GATE_M, compute_reach, is_beyond_gate, may_meet
from mqslam.backend.loops.chain import Chain
from mqslam.mapping.keyframing import pick_spaced


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
    meeting = np.zeros((len(nodes), len(nodes)), dtype=np.bool_)
    unsure = meeting.copy()
    for a, b, relative in zip(earlier, later, chain.relate(pairs), strict=True):
        # the places of a node lie up to GATE_M farther along the path
        meeting[b, a] = may_meet(relative, GATE_M)
        unsure[b, a] = meeting[b, a] and is_beyond_gate(*compute_reach(relative))
    meeting &= np.asarray(unsure.any(axis=1))[:, None]
    node = np.maximum(np.searchsorted(nodes, places, side="right") - 1, 0)
    allowed: NDArray[np.bool_] = meeting[np.ix_(node, node)]
    return np.asarray(allowed & (travelled[places][:, None] - travelled[places][None, :] > passes.LEAST_PATH_M))
