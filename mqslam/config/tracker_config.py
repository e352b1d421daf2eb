"""Settings of odometry by psi."""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict, Field, model_validator


class TrackerConfig(BaseModel):
    """Settings of odometry by psi over a running map."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    keyframe_m: float = Field(
        8.0, gt=0.0, description="a revolution joins the map after this much travel [m], sooner while the map is young"
    )
    keyframe_rad: float = Field(0.1, gt=0.0, description="or after this much turning [rad]")
    keyframes: int = Field(40, ge=1, description="revolutions the map holds")
    sigma_position_m: float = Field(0.01, gt=0.0, description="process noise of the start pose per revolution [m]")
    sigma_yaw: float = Field(0.0003, gt=0.0, description="process noise of the start yaw per revolution [rad]")
    sigma_vx: float = Field(0.6, gt=0.0, description="jump of forward speed per 0.25 s besides acceleration [m/s]")
    sigma_vy: float = Field(0.15, gt=0.0, description="change of sideways speed per 0.25 s [m/s]")
    sigma_omega: float = Field(0.08, gt=0.0, description="jump of yaw rate per 0.25 s besides acceleration [rad/s]")
    sigma_ax: float = Field(4.0, gt=0.0, description="change of forward acceleration per 0.25 s [m/s^2]")
    sigma_alpha: float = Field(0.6, gt=0.0, description="change of yaw acceleration per 0.25 s [rad/s^2]")
    persistence: float = Field(0.9, ge=0.0, le=1.0, description="part of an acceleration that is left after 0.25 s")
    speed_min: float = Field(-5.0, description="slowest speed of the cold start's search [m/s]")
    speed_max: float = Field(40.0, description="fastest speed of the cold start's search [m/s]")
    omega_max: float = Field(1.0, gt=0.0, description="fastest turn of the cold start's search [rad/s]")
    sigma_scale: float = Field(
        0.01,
        ge=0.0,
        description="standard deviation of a distance across a gap, per distance: what is published of the length of one "
        "radar's range bins differs by 1.4 %, and a Doppler shift that is ignored costs as much",
    )
    lost_share: float = Field(
        0.5, gt=0.0, lt=1.0, description="a matched share below this part of the usual one means the track may be lost"
    )

    @model_validator(mode="after")
    def _check_speeds(self) -> TrackerConfig:
        if self.speed_max <= self.speed_min:
            raise ValueError(f"speed_max ({self.speed_max}) must be larger than speed_min ({self.speed_min})")
        return self
