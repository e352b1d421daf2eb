"""Settings of the published score."""

from __future__ import annotations

import math
from typing import Literal

from pydantic import BaseModel, ConfigDict, Field


class PsiConfig(BaseModel):
    """Parameters of the published score, named as in the paper, which gives no values: these are ours."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    s: float = Field(2.0, gt=0.0, description="Radius of a point's neighbourhood [m].")
    beta_s: float = Field(1.0, gt=0.0, description="Width of the spatial kernel [m].")
    alpha_t: float | None = Field(
        None,
        ge=0.0,
        description="Difference in time at which the temporal kernel peaks [s]; null takes one turn of the radar.",
    )
    beta_t: float = Field(0.06, gt=0.0, description="Width of the temporal kernel [s].")
    tau: float = Field(0.5, gt=0.0, description="Width of the Lorentzian [m].")
    temporal: Literal["plateau", "gaussian"] = Field(
        "plateau", description="Temporal kernel: plateau is 1 from alpha_t on; gaussian is as printed in (8)."
    )
    numerator: Literal["tau/2", "tau"] = Field(
        "tau/2", description="Numerator of the Lorentzian: tau/2 as in (9), or tau as in Algorithm 1."
    )
    factor: Literal["distance", "kappa"] = Field(
        "distance", description="Factor on the Lorentzian: distance is s_ij as in (10), kappa is kappa_ij as in Algorithm 1."
    )
    unmatched: float = Field(
        1.0,
        ge=0.0,
        description="Charge of a point without a neighbour, in units of the most that one pair can cost; 0 is as printed.",
    )

    @property
    def charge(self) -> float:
        """Cost of one unmatched point."""
        return self.unmatched * (2.0 * self.s / (math.pi * self.tau)) ** 2
