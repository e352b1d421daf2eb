"""A pose graph as a file holds it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import gtsam


@dataclass(frozen=True, slots=True)
class StoredGraph:
    """A graph, and where its poses begin.

    Args:
        factors: the graph.
        values: the values of all variables, as the file has them.
        keys: of the poses, Pose2 or Pose3, in the order of their keys.
        held: keys of the poses that stay where they are, so that they hold the graph; none where its factors do that.
    """

    factors: gtsam.NonlinearFactorGraph
    values: gtsam.Values
    keys: tuple[int, ...]
    held: tuple[int, ...] = ()
