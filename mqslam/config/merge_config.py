"""Settings of a merge: how several recordings become one map, and what changed between them."""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict, Field

from mqslam.config.fields import expert


class MergeConfig(BaseModel):
    """How several recordings become one map, and what changed between them."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    fewest: int = Field(
        5,
        ge=2,
        description="Least number of matches of places that must agree on how two recordings lie to each other.",
    )
    rival: float = Field(
        2.0,
        ge=1.0,
        description="So many times as many matches must agree on how two recordings lie to each other as agree on any other "
        "way; otherwise several places fit, and nothing is linked.",
    )
    rounds: int = Field(
        2,
        ge=1,
        description="Number of searches for further links; each starts from the poses that the links found before have "
        "corrected.",
    )
    moved_m: float = Field(
        0.5,
        gt=0.0,
        description="If the edges in a result's graph alone move a pose farther than this [m], a warning says that what is "
        "no edge, such as GNSS, has held the result.",
    )
    changes: bool = Field(True, description="Whether changes between the recordings are looked for.")
    cell_m: float = Field(1.0, gt=0.0, description="Side of the cells in which returns are compared for changes [m].")
    near_m: float = Field(
        1.0,
        gt=0.0,
        description="A return within this distance [m] of a cell shows it.",
    )
    also: float = Field(
        0.3,
        ge=0.0,
        description="A cell counts as changed only if the keyframes of the other recording that show it are at most so many "
        "times as many as those of the first one.",
    )
    seen: int = Field(
        3,
        ge=2,
        description="So many keyframes of a recording must show a return in a cell, so that traffic, which moves on, and "
        "noise do not count.",
    )
    looks: int = Field(
        3, ge=1, description="So many keyframes of the other recording must look past the cell at something behind it."
    )
    chance: float = Field(
        0.05,
        gt=0.0,
        lt=1.0,
        description="Probability that chance alone makes any cell of a recording count as changed, if looks were "
        "independent: for each cell, this divided by their number is the largest probability that the other recording shows "
        "it in so few looks by chance.",
    )
    reach_m: float = Field(60.0, gt=0.0, description="Cells farther from a keyframe than this [m] are not compared with it.")
    margin_m: float = expert(
        1.0, gt=0.0, description="A ray passes a cell if its first return lies at least this far [m] behind it."
    )
    rays: int = expert(360, ge=36, description="Number of sectors around a keyframe of which the first return is kept.")
    aspects: int = expert(
        12,
        ge=4,
        description="Number of directions from which a cell is seen that are told apart: a surface that one recording sees "
        "from one side need not show from the other.",
    )
    object_m: float = expert(2.5, gt=0.0, description="Changed cells this near to each other [m] are one object.")
    cells: int = expert(2, ge=1, description="An object has at least so many changed cells.")
