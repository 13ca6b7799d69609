"""Laser spot on a sensor: finder, maximum-likelihood fit, tracker."""

from processing.spot.beam_use import BeamShape, BeamUse, FixedLight, beam_shape, fixed_light
from processing.spot.fit_values import SPOT_DTYPE, Spot, SpotFlag
from processing.spot.model_choice import MAX_CHOICE_FRAMES, SpotModel
from processing.spot.profile import compile_kernels
from processing.spot.sensor_model import SensorModel
from processing.spot.tracker import SpotTracker
