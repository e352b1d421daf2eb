"""Settings of maps: how they are rendered, how their places are found again, and how they are used and joined later."""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict, Field

from mqslam.config.fields import expert


class MapConfig(BaseModel):
    """Settings of the rendered map."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    cell_m: float = Field(0.2, gt=0.0, description="Side of a cell of the nav2 map [m].")
    travel_m: float = Field(
        0.1, ge=0.0, description="A scan is rendered once the sensor has moved this far since the last rendered one [m]."
    )
    travel_rad: float = Field(
        0.01, ge=0.0, description="A scan is rendered as well once the sensor has turned by this much [rad]."
    )
    keyframe_m: float = Field(
        2.5, gt=0.0, description="Path [m] between the scans that the result keeps, in which a recording is localised later."
    )


class RecognitionConfig(BaseModel):
    """How a place is found again without a guess of where it is."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    spacing_m: float = Field(10.0, gt=0.0, description="Path [m] between the places that are described and looked up.")
    submap_m: float = Field(
        15.0, gt=0.0, description="A place is described by the returns of scans within this path [m] to either side."
    )
    range_m: float = Field(120.0, gt=0.0, description="Returns farther from a place than this [m] do not describe it.")
    rings: int = expert(40, ge=2, description="Number of rings around a place in which returns are counted.")
    sectors: int = expert(120, ge=8, description="Number of sectors around a place in which returns are counted.")
    aside_m: float = Field(
        9.0,
        ge=0.0,
        description="A place is also recognised from this far to either side [m], as from another lane. Without that, half "
        "of the places that are passed in the opposite direction are not found.",
    )
    guesses: int = Field(3, ge=1, description="Number of places, the likeliest first, that psi compares with a submap.")
    search_m: float = Field(10.0, gt=0.0, description="psi searches this far [m] around such a guess.")
    search_rad: float = Field(0.1, gt=0.0, description="psi searches so far in yaw [rad] around such a guess.")
    row: int = Field(
        3,
        ge=2,
        description="Number of successive matches that must agree for a place to count as recognised: where streets look "
        "alike, single places do, too.",
    )


class LocalisationConfig(BaseModel):
    """How the scans of a recording are laid into the map of another one."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    reach_m: float = Field(
        15.0, gt=0.0, description="A scan is compared with the map's keyframes within this distance of it [m]."
    )
    matched: float = Field(
        0.5,
        gt=0.0,
        lt=1.0,
        description="Least share of a scan's returns that must lie on the map. Parked cars and traffic that have changed "
        "since the map was made take away from it.",
    )
    aside_m: float = Field(
        0.5,
        gt=0.0,
        description="A scan that psi moves farther than this [m] from its prediction is not believed; what the prediction "
        "may have drifted is added to it.",
    )
    sigmas: float = expert(
        3.0, gt=0.0, description="Standard deviations of the prediction that are added to `aside_m` and `aside_rad`."
    )
    block: int = expert(
        6, ge=2, description="Number of submaps that are looked up at a time, until a row of them is recognised."
    )
    sample_m: float = expert(
        20.0, gt=0.0, description="Path [m] between the scans that show how sure the localisation is of itself."
    )
    apart_m: float = expert(
        5.0,
        gt=0.0,
        description="Path [m] between two scans that are laid on keyframes which they do not share, to see how far they "
        "disagree. Over a shorter path they see the same side of everything and err alike, over a longer one the motions "
        "between them err, too.",
    )
    fewest: int = expert(
        20, ge=1, description="With fewer such pairs the recording does not show how sure the localisation is of itself."
    )
    usual_scale: float = expert(
        10.0,
        ge=1.0,
        description="Factor on the variances of psi's curvature where the recording is too short to show it. Drives through "
        "cities have shown 6 to 13.",
    )


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
    sure_m: float = Field(
        0.5,
        gt=0.0,
        description="Changes are looked for only where it is known to within this standard deviation how the recordings lie "
        "to each other [m], half of near_m: far from all links they may lie apart by more than a parked car.",
    )
    cell_m: float = Field(1.0, gt=0.0, description="Side of the cells in which returns are compared for changes [m].")
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
    rays: int = expert(360, ge=36, description="Number of sectors around a keyframe of which the first return is kept.")
    aspects: int = expert(
        12,
        ge=4,
        description="Number of directions from which a cell is seen that are told apart: a surface that one recording sees "
        "from one side need not show from the other.",
    )
    cells: int = expert(2, ge=1, description="An object has at least so many changed cells.")
