"""The instrument as configured: camera, sensor, pendulum and materials from their sections."""

from acquisition.camera import Camera, CameraSettings
from acquisition.cameras import drivers
from acquisition.frame_queue import Policy
from processing.contact import Material, PendulumOnBall
from processing.contact import material as material_by_name
from processing.contact import pendulum_on_ball as pendulum_after_hertz
from processing.errors import ConfigurationError
from processing.spot import SensorModel
from rig.instrument.calibration import fill_from_files
from rig.instrument.simulated_rig import fill_from_truth
from rig.settings import Configuration


def complete(config: Configuration) -> Configuration:
    """Fill the sections that are not stated: from calibration files, and from a simulated rig's truth."""
    config = fill_from_files(config)
    return fill_from_truth(config) if config.simulated else config


def make_camera(config: Configuration) -> Camera:
    """The configured camera, not opened yet."""
    name = config.camera.driver
    sections = drivers.find_driver(name).sections
    if sections:
        return drivers.make_camera(name, *(getattr(config, section) for section in sections))
    return drivers.make_camera(name, config.camera.driver_settings())


def camera_settings(config: Configuration) -> CameraSettings:
    """What is asked of the camera, without the choice of the camera."""
    return CameraSettings(**{name: getattr(config.camera, name) for name in CameraSettings.model_fields})


def setting_differences(asked: CameraSettings, applied: CameraSettings) -> list[str]:
    """One line for each setting that the camera did not take as it was asked."""
    lines = []
    for name, wanted in asked.model_dump(exclude_none=True).items():
        got = getattr(applied, name)
        near = (
            isinstance(wanted, float)
            and isinstance(got, int | float)
            and abs(got - wanted) <= 1e-3 * abs(wanted)
        )
        if got != wanted and not near:
            lines.append(f"camera.{name} = {wanted} was asked, the camera says {got}")
    return lines


def sensor_model(config: Configuration, full_scale_dn: float) -> SensorModel:
    """Noise model of the sensor for the tracker; without [sensor] one that is typical of small CMOS sensors.

    A typical 10 ke- full well is assumed then; uncertainties follow the fit's own chi2 upward.
    """
    if config.sensor is not None:
        return config.sensor
    return SensorModel(gain_e_per_dn=10_000.0 / full_scale_dn, read_noise_e=7.0, full_scale_dn=full_scale_dn)


def pendulum_on_ball(config: Configuration) -> PendulumOnBall | None:
    """Mass, ball and contact radius (Hertz, where it is not stated); None without [pendulum]."""
    pendulum = config.pendulum
    if pendulum is None:
        return None
    # what one ball carries: moments and energies are then those of one ball
    mass_kg = pendulum.mass_kg / balls(config)
    if pendulum.contact_radius_m is not None:
        return PendulumOnBall(
            mass_kg, pendulum.ball_radius_m, pendulum.contact_radius_m, pendulum.gravity_m_per_s2
        )
    return pendulum_after_hertz(
        mass_kg,
        pendulum.ball_radius_m,
        material(config, pendulum.ball_material),
        material(config, pendulum.flat_material),
        gravity_m_per_s2=pendulum.gravity_m_per_s2,
    )


def balls(config: Configuration) -> int:
    """How many equal balls share the weight."""
    return config.instrument.description().supports


def material(config: Configuration, name: str) -> Material:
    """A material by name, the configuration's own before the paper's."""
    return material_by_name(name, config.materials)


def check_materials(config: Configuration) -> None:
    """Raise ConfigurationError for a material that nobody knows, before anything is measured."""
    if config.pendulum is not None and config.pendulum.contact_radius_m is None:
        try:
            pendulum_on_ball(config)
        except ConfigurationError as error:
            raise ConfigurationError(f"pendulum: {error} under [materials.NAME]") from None


def frame_policy(config: Configuration) -> Policy:
    """Sources that can wait are held back and lose nothing; a real camera cannot wait."""
    return "wait" if config.on_demand else "every"
