"""Settings of localisation: how the scans of a recording are laid into an earlier map."""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict, Field

from mqslam.config.fields import expert


class LocalisationConfig(BaseModel):
    """How the scans of a recording are laid into the map of another one."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    reach_m: float = Field(
        15.0, gt=0.0, description="A scan is compared with the map's keyframes within this distance of it [m]."
    )
    renew_m: float = expert(
        2.5,
        gt=0.0,
        description="The keyframes around the vehicle are chosen anew once it has moved this far [m]. More of it is faster, "
        "and lays scans on keyframes that are less well centred around them.",
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
    aside_rad: float = Field(0.03, gt=0.0, description="Yaw [rad] beyond which a scan is not believed in the same way.")
    sigmas: float = expert(
        3.0, gt=0.0, description="Standard deviations of the prediction that are added to `aside_m` and `aside_rad`."
    )
    give_up_m: float = Field(
        30.0,
        gt=0.0,
        description="Path [m] without a scan that lies on the map, after which scans are no longer followed from there. "
        "The recording is then looked up again beyond it.",
    )
    confirmed: float = expert(
        0.7,
        gt=0.0,
        le=1.0,
        description="Least share of the scans along a row of recognised places that must lie on the map for it to count.",
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
