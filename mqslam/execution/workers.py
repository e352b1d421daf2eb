"""Where a command's work is done."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from mqslam.execution.engine import Engine


@contextmanager
def choose_engine(cluster: str | None, jobs: int) -> Iterator[Engine]:
    """The workers of a cluster if there is an address of one, or so many jobs on this machine.

    Raises:
        ClusterError: the cluster cannot be used.
    """
    if cluster is None:
        from mqslam.execution.engine import LocalEngine

        yield LocalEngine(jobs)
    else:
        from mqslam.execution.cluster import connect

        with connect(cluster) as engine:
            yield engine
