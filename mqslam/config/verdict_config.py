"""Settings of a verdict on a map."""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict, Field


class VerdictConfig(BaseModel):
    """When a map is called `warn` or `fail`, and how much evidence a verdict takes."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    confidence: float = Field(
        0.95,
        gt=0.5,
        lt=1.0,
        description="a share is called too large only where its exact binomial lower bound (Clopper-Pearson) at this "
        "confidence is: of maps that are good enough, one in twenty at most is called otherwise by chance",
    )
    power: float = Field(
        0.8,
        gt=0.5,
        lt=1.0,
        description="a map passes only where one whose share is at the bound of `fail` would have shown more with this "
        "probability; where no window is torn that takes 8 windows",
    )
    windows_warn: float = Field(0.05, ge=0.0, lt=1.0, description="a larger share of torn windows is worth a look")
    windows_fail: float = Field(0.2, ge=0.0, lt=1.0, description="a larger share of torn windows makes a map useless")
    revisits_warn: float = Field(
        0.02, ge=0.0, lt=1.0, description="the same for revisits: a place that looks like another may seem torn"
    )
    revisits_fail: float = Field(0.1, ge=0.0, lt=1.0, description="a larger share of torn revisits shows drift all over")
    lost_fail: float = Field(
        0.2, ge=0.0, lt=1.0, description="a larger share of lost scans leaves a track of predictions; any is worth a look"
    )
    degenerate_warn: float = Field(
        0.1, ge=0.0, lt=1.0, description="a larger share of scans that do not observe every direction is worth a look"
    )
    matched: float = Field(
        0.15, ge=0.0, lt=1.0, description="a window in which fewer points are seen twice does not overlap, and psi is blind"
    )
    worse: float = Field(
        1.1,
        ge=1.0,
        description="psi per point after optimisation over that before which is a fault; passes that loops lay on each "
        "other cost a little more than alone",
    )
