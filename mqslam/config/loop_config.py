"""Settings of loop closures."""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict, Field


class LoopConfig(BaseModel):
    """Settings of loop closures."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    enabled: bool = Field(True, description="whether loops are looked for")
    rounds: int = Field(2, ge=1, description="searches; each starts from the trajectory the one before has mended")
    passes: int = Field(1, ge=1, description="earlier passes a revolution is tied to, the nearest first")
    spacing_m: float = Field(5.0, gt=0.0, description="path between revolutions that are tried and rendered [m]")
    least_path_m: float = Field(60.0, gt=0.0, description="shorter ways round are odometry, not loops [m]")
    reach_m: float = Field(12.0, gt=0.0, description="two passes this far apart still see the same things [m]")
    drift: float = Field(0.005, ge=0.0, description="drift of the trajectory to reckon with, per path [m/m]")
    drift_rad: float = Field(3e-5, ge=0.0, description="the same for yaw [rad/m]")
    search_m: float = Field(3.0, gt=0.0, description="least half width of the search [m]")
    search_rad: float = Field(0.03, gt=0.0, description="the same for yaw [rad]")
    gate_m: float = Field(40.0, gt=0.0, description="largest half width of the search [m]")
    gate_rad: float = Field(0.15, gt=0.0, description="the same for yaw [rad]")
    submap_m: float = Field(15.0, gt=0.0, description="path around a revolution that its submap holds, either way [m]")
    fewest: int = Field(300, ge=1, description="least returns of a submap")
    matched: float = Field(0.45, gt=0.0, lt=1.0, description="least share of returns that lie on the other pass")
    rival: float = Field(1.1, ge=1.0, description="the next best pose must score worse by this factor")
    sure_m: float = Field(0.3, gt=0.0, description="largest standard deviation of a loop's position [m]")
    kept: float = Field(1.1, ge=1.0, description="a loop stays if psi under the final poses is within this of its own")
    floor_m: float = Field(0.05, gt=0.0, description="standard deviation of a loop besides its own: submaps bend [m]")
    floor_rad: float = Field(0.0015, gt=0.0, description="the same for yaw [rad]")
    cauchy: float = Field(3.0, gt=0.0, description="residual at which a loop's pull begins to fade [sigma]")
