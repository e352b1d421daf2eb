"""What the interactive part of a page shows: a map, curves over time, and close views of places that can be clicked."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, TypeAlias

import numpy as np
from numpy.typing import NDArray

from mqslam.report.figures.canvas import BLUE, ORANGE

# shapes of dots, so that what is torn can be told from what is not without seeing red and green
FINE: Final = "circle"
TORN: Final = "triangle-up"
UNKNOWN: Final = "square-open"

Points: TypeAlias = NDArray[np.float64]
Values: TypeAlias = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Layer:
    """A map and the trajectory under which it was rendered.

    Args:
        name: name of the trajectory.
        colour: colour of its path.
        path_times: (K,) [s], increasing.
        path: (K, 2) [m].
        points: (N, 2) [m].
        values: (N,) each, by their names: time, psi, intensity, as far as they are known.
        shown: whether it is visible at first.
        ink: colour of its points; None is the page's ink.
    """

    name: str
    colour: str
    path_times: Values
    path: Points
    points: Points
    values: dict[str, Values]
    shown: bool = True
    ink: str | None = None


@dataclass(frozen=True, slots=True)
class Lines:
    """Lines on the map, several in one, with a row of NaN after each.

    Args:
        name: name in the legend.
        colour: colour of the lines.
        points: (N, 2) [m].
        width: width of the lines [pixels].
        shown: whether they are visible at first.
    """

    name: str
    colour: str
    points: Points
    width: float = 1.5
    shown: bool = True


@dataclass(frozen=True, slots=True)
class ExplorerCurve:
    """Values over time, as a line or as dots.

    Args:
        name: name in the legend.
        colour: colour of the curve.
        times: (N,) [s].
        values: (N,).
        dots: whether it is drawn as dots.
        mark: shape of the dots.
    """

    name: str
    colour: str
    times: Values
    values: Values
    dots: bool = False
    mark: str = FINE


@dataclass(frozen=True, slots=True)
class Chart:
    """Curves that share an axis.

    Args:
        title: title of the axis.
        curves: the curves.
        levels: name, value and colour of lines across the chart.
        log: whether the axis is logarithmic.
    """

    title: str
    curves: tuple[ExplorerCurve, ...]
    levels: tuple[tuple[str, float, str], ...] = ()
    log: bool = False


@dataclass(frozen=True, slots=True)
class PlaceView:
    """The points of a place under one trajectory.

    Args:
        name: name of the trajectory.
        groups: (M, 2) [m] each.
        colours: colour of each group.
    """

    name: str
    groups: tuple[Points, ...]
    colours: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class ExplorerPlace:
    """What is shown of a place when it is clicked.

    Args:
        t0, t1: when the sensor was there [s].
        title, text: what the place is.
        torn: whether it is marked as torn.
        views: close views side by side, on one extent.
        unknown: whether it could not be judged.
    """

    t0: float
    t1: float
    title: str
    text: str
    torn: bool
    views: tuple[PlaceView, ...]
    unknown: bool = False

    @property
    def kind(self) -> str:
        """What its dot on the map says of it."""
        return "torn" if self.torn else "unknown" if self.unknown else "fine"


@dataclass(frozen=True, slots=True)
class Explorer:
    """The whole interactive part.

    Args:
        layers: maps; a click marks the place on all of them, dots mark the places on the first that is shown.
        charts: charts over time, one below the other.
        places: places that can be clicked, in the order of time.
        lines: further lines on the map.
        groups: names of the groups of a view's points, as far as they need one.
        first: number of the place shown first.
        first_is: what the place shown first is; empty where its title says enough.
        calm: whether the places do not count against the map, so that the place chosen is marked in grey, not in red.
        explained: what the reader should know about it: a line, and what else there is to know.
    """

    layers: tuple[Layer, ...]
    charts: tuple[Chart, ...]
    places: tuple[ExplorerPlace, ...]
    lines: tuple[Lines, ...] = ()
    groups: tuple[str, ...] = ()
    first: int = 0
    first_is: str = ""
    calm: bool = False
    explained: tuple[str, ...] = ()


def mix_shades(count: int) -> tuple[str, ...]:
    """Returns the colours of groups in the order of time: the first blue, the last orange."""
    ends = np.array([[int(colour[k : k + 2], 16) for k in (1, 3, 5)] for colour in (BLUE, ORANGE)])
    mixed = [(1.0 - share) * ends[0] + share * ends[1] for share in np.linspace(0.0, 1.0, count)]
    return tuple("#" + "".join(f"{round(part):02x}" for part in colour) for colour in mixed)


def join_lines(lines: Sequence[Points]) -> Points:
    """Returns lines (N_k, 2) as one array, with a row of NaN after each."""
    gap = np.full((1, 2), np.nan)
    return np.concatenate([part for one in lines for part in (one, gap)]) if lines else np.empty((0, 2))
