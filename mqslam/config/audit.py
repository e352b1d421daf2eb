"""Settings of an audit."""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict, Field


def inflation_quantile(probability: float) -> float:
    """Quantile of the chi-square with three degrees of freedom, which the inflation of a map that is right follows.

    Args:
        probability: between 0 and 1.
    """
    from scipy.special import gammaincinv  # every command reads settings and few need a quantile; scipy.stats takes longer

    return 2.0 * float(gammaincinv(1.5, probability))


class AuditConfig(BaseModel):
    """How a map is judged."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    window: int = Field(6, ge=2, description="revolutions or scans of a window")
    probability: float = Field(
        0.999, gt=0.5, lt=1.0, description="a window or revisit is torn beyond this quantile of the chi-square"
    )
    bend_m: float = Field(0.05, ge=0.0, description="windows that a correction moves by less than this are not torn [m]")
    overlap: float = Field(
        0.5, ge=0.0, lt=1.0, description="a window is torn as well where its best map has a smaller matched share than this"
    )
    radius_m: float = Field(1.0, gt=0.0, description="neighbourhood of the entropies and of the plane variance [m]")
    cell_m: float = Field(0.5, gt=0.0, description="cell of the evidence grid [m]")
    spacing_m: float = Field(10.0, gt=0.0, description="path between the revisits that are measured [m]")
    submap_spacing_m: float = Field(5.0, gt=0.0, description="path between the sweeps a submap is made of [m]")
    submap_m: float = Field(15.0, gt=0.0, description="path around a revisit that its submap holds, either way [m]")
    least_path_m: float = Field(60.0, gt=0.0, description="shorter ways round are no revisits [m]")
    reach_m: float = Field(12.0, gt=0.0, description="two passes this far apart still see the same things [m]")
    drift: float = Field(0.02, ge=0.0, description="drift of an audited trajectory to reckon with, per path [m/m]")
    drift_rad: float = Field(1e-4, ge=0.0, description="the same for yaw [rad/m]")
    search_m: float = Field(3.0, gt=0.0, description="least half width of a revisit's search [m]")
    search_rad: float = Field(0.05, gt=0.0, description="the same for yaw [rad]")
    gate_m: float = Field(40.0, gt=0.0, description="largest half width of the search [m]")
    gate_rad: float = Field(0.3, gt=0.0, description="the same for yaw [rad]")
    fewest: int = Field(300, ge=1, description="least returns of a submap")
    matched: float = Field(0.45, gt=0.0, lt=1.0, description="least share of returns that lie on the other pass")
    rival: float = Field(1.1, ge=1.0, description="the next best offset must score worse by this factor")
    torn_m: float = Field(0.5, gt=0.0, description="smaller offsets between two passes are not torn [m]")
    torn_rad: float = Field(0.02, gt=0.0, description="unless they are turned by more than this [rad]")

    @property
    def threshold(self) -> float:
        """Inflation beyond which a window or a revisit is bent by more than chance, with three degrees of freedom."""
        return inflation_quantile(self.probability)
