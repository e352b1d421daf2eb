"""Settings of what is taken from the power of polar scans: the returns."""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict, Field, model_validator


class DetectorConfig(BaseModel):
    """Settings of the detector."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    threshold: float = Field(
        40.0, ge=0.0, le=255.0, description="Smoothed power above which a peak is a target in any data [0..255]."
    )
    contrast: float = Field(
        7.0,
        gt=0.0,
        description="Detection threshold in low-noise data, above the median power and in units of the noise spread "
        "(median minus 10th percentile). It applies where it is below `threshold`.",
    )
    most_returns: int = Field(
        1000,
        ge=1,
        description="Number of returns that are kept per scan, the strongest. All that stand out of the noise by "
        "`contrast` are kept, however many they are.",
    )
    min_range_m: float = Field(2.5, ge=0.0, description="Nearer returns are of the vehicle itself and are dropped [m].")
    max_range_m: float = Field(
        150.0, gt=0.0, description="Farther returns are dropped [m]: they are too blurred across the beam to help."
    )

    @model_validator(mode="after")
    def _check_ranges(self) -> DetectorConfig:
        if self.max_range_m <= self.min_range_m:
            raise ValueError(f"max_range_m ({self.max_range_m}) must be larger than min_range_m ({self.min_range_m})")
        return self
