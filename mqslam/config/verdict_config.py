"""Settings of a verdict on a map."""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict, Field

from mqslam.config.fields import expert


class VerdictConfig(BaseModel):
    """When a map is called `warn` or `fail`, and how much evidence a verdict takes."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    confidence: float = Field(
        0.95,
        gt=0.5,
        lt=1.0,
        description="Confidence of the exact binomial lower bound (Clopper and Pearson) of a share, which must exceed a "
        "limit before the share is called too large. At 0.95, at most one in twenty good maps is called bad by chance.",
    )
    power: float = Field(
        0.8,
        gt=0.5,
        lt=1.0,
        description="A map passes only if a map whose share is at the limit of `fail` would have shown more faults with "
        "this probability. Where no window is torn that takes 8 windows.",
    )
    windows_warn: float = Field(
        0.05, ge=0.0, lt=1.0, description="A map with a larger share of torn windows than this is worth a look."
    )
    windows_fail: float = Field(
        0.2, ge=0.0, lt=1.0, description="A map with a larger share of torn windows than this is useless."
    )
    revisits_warn: float = Field(
        0.02,
        ge=0.0,
        lt=1.0,
        description="A map with a larger share of torn revisits than this is worth a look; a few may be places that only "
        "look alike.",
    )
    revisits_fail: float = Field(
        0.1, ge=0.0, lt=1.0, description="A larger share of torn revisits than this shows that the whole map drifts."
    )
    lost_fail: float = Field(
        0.2,
        ge=0.0,
        lt=1.0,
        description="With a larger share of lost scans than this the trajectory is mostly prediction. Any lost scan is "
        "worth a look.",
    )
    degenerate_warn: float = Field(
        0.1,
        ge=0.0,
        lt=1.0,
        description="A larger share than this of scans that do not observe every direction is worth a look.",
    )
    matched: float = Field(
        0.15,
        ge=0.0,
        lt=1.0,
        description="A window in which a smaller share of points than this is seen twice does not overlap, so that psi "
        "cannot judge it.",
    )
    apart_fail: float = expert(
        0.5,
        ge=0.0,
        lt=1.0,
        description="With a larger share than this of windows that do not overlap, a map is useless as a whole.",
    )
    worse: float = Field(
        1.1,
        ge=1.0,
        description="Ratio of psi per point after optimisation to that before, above which optimisation made the map worse. "
        "Passes that loops lay on each other cost a little more than each pass alone.",
    )
