"""The optics that turn an image into a deflection: sensor noise, shutter, light lever, pendulum axes."""

from dataclasses import dataclass

from calibration import GLOBAL, Axes, Lever, Shutter, deflection_unit
from processing.deflections import DeflectionUnit
from processing.spot import SensorModel, SpotTracker
from rig.instrument.light_times import shutter_of
from rig.instrument.pipeline import Deflector, Pipeline
from rig.settings import Configuration


@dataclass(frozen=True, slots=True)
class Optics:
    """Calibrated values of the optical path; without a `lever` deflections are in px."""

    sensor: SensorModel
    lever: Lever | None
    axes: Axes
    shutter: Shutter = GLOBAL

    def tracker(self) -> SpotTracker:
        """A new tracker."""
        return SpotTracker(self.sensor)

    def deflector(self, sensor_shape: tuple[int, int]) -> Deflector:
        """Converts spots to deflections, on a sensor of (ny, nx) pixels."""
        return Deflector(self.lever, self.axes, sensor_shape, self.shutter)

    def pipeline(self, sensor_shape: tuple[int, int], *, beside: bool = False) -> Pipeline:
        """A new pipeline from frames to deflections and half-cycles."""
        return Pipeline(
            self.tracker(),
            self.lever,
            self.axes,
            sensor_shape,
            shutter=self.shutter,
            beside=beside,
        )

    @property
    def unit(self) -> DeflectionUnit:
        """Unit of the deflections."""
        return deflection_unit(self.lever)


def optics_of(config: Configuration, full_scale_dn: float) -> Optics:
    """The optics as configured, for a camera whose pixels saturate at `full_scale_dn`."""
    return Optics(
        sensor_model(config, full_scale_dn), config.lever, config.axes or Axes(), shutter_of(config)
    )


def sensor_model(config: Configuration, full_scale_dn: float) -> SensorModel:
    """Noise model of the sensor for the tracker.

    Without [sensor] a full well of 10 000 electrons is assumed, typical of small CMOS sensors; the
    tracker increases its uncertainties if the chi2 of its fit shows that they are too small.
    """
    if config.sensor is not None:
        return config.sensor
    return SensorModel(gain_e_per_dn=10_000.0 / full_scale_dn, read_noise_e=7.0, full_scale_dn=full_scale_dn)
