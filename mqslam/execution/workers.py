"""The choice of the engine that does a command's work."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from mqslam.core.engine import Engine


@contextmanager
def choose_engine(cluster: str | None, jobs: int) -> Iterator[Engine]:
    """Yields the workers of a cluster, or this machine's if no cluster is given.

    Args:
        cluster: address of a cluster, or None.
        jobs: number of processes to use on this machine.

    Raises:
        ClusterError: the cluster cannot be used.
    """
    if cluster is None:
        from mqslam.execution.local_engine import LocalEngine

        with LocalEngine(jobs) as here:
            yield here
    else:
        from mqslam.execution.cluster import connect

        with connect(cluster) as engine:
            yield engine
