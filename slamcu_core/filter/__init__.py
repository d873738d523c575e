"""The filter that runs in the car: the paper's sections 4 and 5."""

from slamcu_core.filter.estimates import FeatureEstimate, PoseEstimate
from slamcu_core.filter.parameters import FilterParameters
from slamcu_core.filter.slamcu import SlamcuFilter

__all__ = ["FeatureEstimate", "FilterParameters", "PoseEstimate", "SlamcuFilter"]
