"""Laser spot on a sensor: finder, maximum-likelihood fit, tracker."""

from processing.spot.model_choice import SpotModel
from processing.spot.profile import compile_kernels
from processing.spot.sensor_model import SensorModel
from processing.spot.spot import SPOT_DTYPE, Spot, SpotFlag
from processing.spot.tracker import SpotTracker

__all__ = ["SPOT_DTYPE", "SensorModel", "Spot", "SpotFlag", "SpotModel", "SpotTracker", "compile_kernels"]
