"""All motion models by name."""

from __future__ import annotations

from mqslam.core.motion import ACCELERATED_TWIST, CONSTANT_TWIST, CONSTANT_VELOCITY

MODELS = {model.name: model for model in (CONSTANT_VELOCITY, CONSTANT_TWIST, ACCELERATED_TWIST)}
