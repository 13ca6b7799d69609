"""Laser spot on a sensor: finder, maximum-likelihood fit, tracker."""

from processing.spot.beam_use import BeamUse, FixedLight, fixed_light
from processing.spot.model_choice import LONGEST_CHOICE_FRAMES, SpotModel
from processing.spot.profile import compile_kernels
from processing.spot.sensor_model import SensorModel
from processing.spot.shape import BeamShape, beam_shape
from processing.spot.spot import SPOT_DTYPE, Spot, SpotFlag
from processing.spot.tracker import SpotTracker
