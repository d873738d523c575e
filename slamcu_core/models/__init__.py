"""Motion and measurement models: what moves the particles and what a sensor should see from them."""

from slamcu_core.models.motion import MotionNoise, advance, arc, yaw_rate_from_steering
from slamcu_core.models.sensor import Jacobian, SensorModel, Sight
from slamcu_core.models.visibility import occlusion_probability, shadow_angle, visibility_probability

__all__ = [
    "Jacobian",
    "MotionNoise",
    "SensorModel",
    "Sight",
    "advance",
    "arc",
    "occlusion_probability",
    "shadow_angle",
    "visibility_probability",
    "yaw_rate_from_steering",
]
