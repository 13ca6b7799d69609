"""What turns an image into a deflection: the sensor's noise model, the light lever, the pendulum's axes."""

from dataclasses import dataclass

from calibration.axes import Axes
from calibration.lever import Lever, deflection_unit
from processing.deflections import DeflectionUnit
from processing.spot import SensorModel, SpotTracker
from rig.instrument.pipeline import Deflector, Pipeline
from rig.settings import Configuration


@dataclass(frozen=True, slots=True)
class Optics:
    """Calibrated values of the optical path; without a `lever` deflections are in px."""

    sensor: SensorModel
    lever: Lever | None
    axes: Axes

    def tracker(self) -> SpotTracker:
        """A tracker that has not seen a spot yet."""
        return SpotTracker(self.sensor)

    def deflector(self, sensor_shape: tuple[int, int]) -> Deflector:
        """Spots to deflections, on a sensor of (ny, nx) pixels."""
        return Deflector(self.lever, self.axes, sensor_shape)

    def pipeline(self, sensor_shape: tuple[int, int]) -> Pipeline:
        """Frames to deflections and half-cycles; it has not seen a frame yet."""
        return Pipeline(self.tracker(), self.lever, self.axes, sensor_shape)

    @property
    def unit(self) -> DeflectionUnit:
        """Unit of the deflections."""
        return deflection_unit(self.lever)


def optics_of(config: Configuration, full_scale_dn: float) -> Optics:
    """The optics as configured, for a camera whose pixels saturate at `full_scale_dn`."""
    return Optics(sensor_model(config, full_scale_dn), config.lever, config.axes or Axes())


def sensor_model(config: Configuration, full_scale_dn: float) -> SensorModel:
    """Noise model of the sensor for the tracker; without [sensor] one that is typical of small CMOS sensors.

    A typical 10 ke- full well is assumed then; uncertainties follow the fit's own chi2 upward.
    """
    if config.sensor is not None:
        return config.sensor
    return SensorModel(gain_e_per_dn=10_000.0 / full_scale_dn, read_noise_e=7.0, full_scale_dn=full_scale_dn)
