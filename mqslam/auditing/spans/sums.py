"""Adds up successive spans, to find a trajectory that bends little in every span, but much over many spans.

Each span may be off by less than is tolerated while all spans are off to the same side. Successive spans are therefore added
up over 60 to 240 m of path.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from mqslam.auditing.spans.torn import COMMON, FREEDOM, SpanAudit
from mqslam.auditing.sweeps import Sweeps
from mqslam.auditing.table import share_of_false_alarms, tolerate_sum
from mqslam.config import AuditConfig, VerdictConfig
from mqslam.core import se2
from mqslam.core.statistics import compute_p_values, correct_for_places

LENGTHS_M: Final = (60.0, 120.0, 240.0)
"""Lengths of path over which spans are added up [m]: a bend of any length fills at least half of one of them."""
_LARGEST_GAP: Final = 0.5  # most path between the end of a span and the begin of the next span, as a share of a span
_OVERLAP: Final = 0.1  # most path that two successive spans share, as a share of a span, since spans begin and end at scans


@dataclass(frozen=True, slots=True)
class SumAudit:
    """The judgement of a sum of successive spans.

    Args:
        earlier, later: numbers of the sweeps at which the first span begins and the last span ends.
        t0, t1: times of these sweeps [s] since the recording's start.
        path_m: length of the path from the begin of the first span to the end of the last span [m].
        offset: (3,) pose of the end by psi relative to its pose by the trajectory, in the frame of the end [m, m, rad],
            without the part that errors of the whole trajectory (`Pooled`) explain.
        covariance: (3, 3) covariance of the offset, with the drift of psi itself.
        p_value: probability that a good map has a sum this far off anywhere.
        torn: whether the end is off by more than chance explains and by more than is tolerated.
    """

    earlier: int
    later: int
    t0: float
    t1: float
    path_m: float
    offset: se2.Array
    covariance: NDArray[np.float64]
    p_value: float
    torn: bool

    @property
    def distance_m(self) -> float:
        """Distance in x and y by which the end of the sum is off [m]."""
        return float(np.hypot(self.offset[0], self.offset[1]))


def audit_sums(spans: Sequence[SpanAudit], sweeps: Sweeps, settings: AuditConfig, limits: VerdictConfig) -> list[SumAudit]:
    """Judges the sums of successive spans, in the order of their begin; an empty list if no sum is long enough.

    Args:
        spans: spans of a map in the order of time; spans without a p-value are left out.
        sweeps: points under the trajectory to judge.
        settings: settings of the audit, with the tolerances.
        limits: settings of the verdict.
    """
    judged = [span for span in spans if np.isfinite(span.p_value)]
    begins_m = sweeps.travelled[[span.registration.earlier for span in judged]]
    chains = [chain for span in judged for chain in _follow(span, judged, begins_m, sweeps.travelled)]
    if not chains:
        return []
    sums = [_add_up(chain, sweeps) for chain in chains]
    offsets, covariances = (np.array(part) for part in zip(*sums, strict=True))
    p_values = correct_for_places(compute_p_values(se2.normalise(offsets, covariances), FREEDOM * len(judged)))
    metres, radians = tolerate_sum(settings)
    is_large = (np.hypot(*offsets[:, :2].T) > metres) | (np.abs(offsets[:, 2]) > radians)
    torn = is_large & (p_values < share_of_false_alarms(limits))
    return [
        SumAudit(
            earlier=chain[0].registration.earlier,
            later=chain[-1].registration.later,
            t0=chain[0].t0,
            t1=chain[-1].t1,
            path_m=_measure_path(chain, sweeps.travelled),
            offset=offsets[k],
            covariance=covariances[k],
            p_value=float(p_values[k]),
            torn=bool(torn[k]),
        )
        for k, chain in enumerate(chains)
    ]


def find_bends(sums: Sequence[SumAudit]) -> list[SumAudit]:
    """Returns the torn sums in the order of time; of torn sums that overlap, only the one with the smallest p-value."""
    bends: list[SumAudit] = []
    for one in sorted((one for one in sums if one.torn), key=lambda one: one.p_value):
        if all(one.t1 <= other.t0 or other.t1 <= one.t0 for other in bends):
            bends.append(one)
    return sorted(bends, key=lambda one: one.t0)


def _follow(
    first: SpanAudit, spans: Sequence[SpanAudit], begins_m: NDArray[np.float64], travelled: NDArray[np.float64]
) -> Iterator[list[SpanAudit]]:
    """Yields for each of `LENGTHS_M` the chain of successive spans from `first` on; stops where no span follows closely.

    Args:
        first: first span of the chains.
        spans: N spans in the order of time.
        begins_m: (N,) length of the path up to the begin of each span [m].
        travelled: (S,) length of the path up to each sweep [m].
    """
    chain = [first]
    for length_m in LENGTHS_M:
        while _measure_path(chain, travelled) < length_m - 0.5 * chain[-1].registration.path_m:
            last = chain[-1].registration
            end_m = travelled[last.later]
            k = int(np.searchsorted(begins_m, end_m - _OVERLAP * last.path_m))
            if k == len(spans) or begins_m[k] - end_m > _LARGEST_GAP * last.path_m:
                return
            chain.append(spans[k])
        yield chain.copy()


def _measure_path(chain: Sequence[SpanAudit], travelled: NDArray[np.float64]) -> float:
    """Returns the length of the path [m] from the begin of a chain's first span to the end of its last span.

    `travelled` (S,) is the length of the path up to each sweep [m].
    """
    return float(travelled[chain[-1].registration.later] - travelled[chain[0].registration.earlier])


def _add_up(chain: Sequence[SpanAudit], sweeps: Sweeps) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Returns the offset (3,) [m, m, rad] of the end of a chain of spans and the offset's covariance, in the end's frame."""
    end = sweeps.poses[chain[-1].registration.later]
    levers = [se2.adjoint(se2.between(end, sweeps.poses[span.registration.later])) for span in chain]
    offset = sum((lever @ span.offset for lever, span in zip(levers, chain, strict=True)), np.zeros(3))
    covariance = sum(
        (
            lever @ (span.covariance + COMMON * span.registration.path_m) @ lever.T
            for lever, span in zip(levers, chain, strict=True)
        ),
        np.zeros((3, 3)),
    )
    return offset, covariance
