"""Settings of loop closures and of the refinement after them."""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict, Field


class LoopConfig(BaseModel):
    """Settings of loop closures."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    enabled: bool = Field(True, description="Whether loops are looked for.")


class RefinementConfig(BaseModel):
    """Settings of the refinement of a trajectory, once its loops are closed."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    rounds: int = Field(
        0,
        ge=0,
        description="Most rounds in which every scan is measured against the other passes around it; each starts from the "
        "trajectory that the round before has refined. 0 leaves the trajectory as the loops have made it: passes lie "
        "better on each other after two rounds, but the trajectory as a whole was not always nearer to the truth.",
    )
