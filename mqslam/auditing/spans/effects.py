"""Computes the linear effects of biases, a lever arm and a delay (see `pooled`) on the offsets of spans."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from mqslam.auditing.registration import Registration
from mqslam.core import se2


def measure_moves(spans: Sequence[Registration]) -> NDArray[np.float64]:
    """Returns the vectors (N, 2) [m] from the begin of each of N spans to its end, in the frame of the end."""
    return np.array([-se2.inverse(span.between)[:2] for span in spans]).reshape(-1, 2)


def resolve(spans: Sequence[Registration], placed: NDArray[np.float64]) -> NDArray[np.float64]:
    """Splits offsets `placed` (N, 2) [m] of spans into parts (N, 2) [m] along the line from begin to end and to its left."""
    moves = measure_moves(spans)
    x, y = moves.T
    along = np.column_stack([(moves * placed).sum(axis=1), x * placed[:, 1] - y * placed[:, 0]])
    return np.asarray(along / np.hypot(x, y)[:, None])


def of_direction(spans: Sequence[Registration]) -> NDArray[np.float64]:
    """Returns the matrices (N, 2, 2) from a bias of all motions to its effects on N spans.

    They convert the motion per metre of path that the trajectory lacks (forward, left) [m/m] to offsets [m]: how far psi
    moves the end of each span from its place in the trajectory.
    """
    x, y = measure_moves(spans).T
    return np.moveaxis(np.array([[x, -y], [y, x]]), -1, 0)


def of_turn(spans: Sequence[Registration]) -> NDArray[np.float64]:
    """Returns the offsets (N, 3) [m, m, rad] of N spans for a bias of the yaw of 1 rad/m, of first order in the angle."""
    path = np.array([span.path_m for span in spans])
    x, y = measure_moves(spans).T
    return np.column_stack([-0.5 * path * y, 0.5 * path * x, path])


def of_lever(spans: Sequence[Registration]) -> NDArray[np.float64]:
    """Returns the matrices (N, 2, 2) that convert a lever arm (ahead, left) [m] to the offsets of N spans [m]."""
    yaws = np.array([span.between[2] for span in spans])
    c, s = np.cos(yaws), np.sin(yaws)
    return np.moveaxis(np.array([[1.0 - c, -s], [s, 1.0 - c]]), -1, 0)


def of_delay(spans: Sequence[Registration], twists: NDArray[np.float64]) -> NDArray[np.float64]:
    """Returns the offsets (N, 3) of N spans per second of delay of the trajectory's stamps [m/s, m/s, rad/s].

    If the stamps are late, the sensor is already at the pose that the trajectory states for a later time, at both ends.

    Args:
        spans: N spans.
        twists: (S, 3) twists of the sensor at every sweep by the trajectory [m/s, m/s, rad/s].
    """
    begin = [se2.adjoint(se2.inverse(span.between)) @ twists[span.earlier] for span in spans]
    return np.reshape([twists[span.later] - by for span, by in zip(spans, begin, strict=True)], (-1, 3))
