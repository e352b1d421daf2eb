"""Settings of the published score."""

from __future__ import annotations

import math
from typing import Literal

from pydantic import BaseModel, ConfigDict, Field


class PsiConfig(BaseModel):
    """Parameters of the published score, named as in the paper, which gives no values: these are ours."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    s: float = Field(2.0, gt=0.0, description="radius of the neighbourhood [m]")
    alpha_s: float = Field(0.0, ge=0.0, description="distance at which the spatial kernel peaks [m]")
    beta_s: float = Field(1.0, gt=0.0, description="width of the spatial kernel [m]")
    alpha_t: float | None = Field(
        None, ge=0.0, description="time apart at which the temporal kernel peaks [s]; null takes one revolution"
    )
    beta_t: float = Field(0.06, gt=0.0, description="width of the temporal kernel [s]")
    tau: float = Field(0.5, gt=0.0, description="width of the Lorentzian [m]")
    xi: float = Field(0.02, gt=0.0, lt=1.0, description="pairs with a smaller kappa take no part")
    temporal: Literal["plateau", "gaussian"] = Field(
        "plateau", description="plateau: the time term is 1 from alpha_t on; gaussian: as printed in (8)"
    )
    numerator: Literal["tau/2", "tau"] = Field("tau/2", description="numerator of L: (9) or Algorithm 1")
    factor: Literal["distance", "kappa"] = Field("distance", description="S = L s_ij (10) or L kappa_ij (Algorithm 1)")
    unmatched: float = Field(
        1.0, ge=0.0, description="charge of a point without a neighbour, in units of the dearest pair; 0 is as printed"
    )

    @property
    def charge(self) -> float:
        """What one unmatched point costs."""
        return self.unmatched * (2.0 * self.s / (math.pi * self.tau)) ** 2
