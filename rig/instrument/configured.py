"""The instrument as configured: what the configuration states, what the simulated rig knows of itself."""

import math

from acquisition.camera import Camera, CameraSettings
from acquisition.cameras import drivers
from acquisition.frame_queue import Policy
from acquisition.simulation.settings import SimulationSettings
from calibration.axes import Axes
from calibration.lever import Lever
from processing.contact import Material, PendulumOnBall
from processing.contact import material as material_by_name
from processing.contact import pendulum_on_ball as pendulum_after_hertz
from processing.errors import ConfigurationError
from processing.spot import SensorModel
from rig.instrument.calibration import fill_from_files
from rig.settings import BalanceSettings, Configuration, MaterialSettings, PendulumSettings, SensorSettings

SIMULATED_BALL = "simulated_ball"
SIMULATED_FLAT = "simulated_flat"


def complete(config: Configuration) -> Configuration:
    """Fill what a simulated rig knows of itself: sensor, lever, axes, pendulum, where they are not stated.

    A rig whose calibration is perfect, so that ``--set simulation...`` changes the truth and what
    the analysis is told of the apparatus together. With a real camera nothing is filled in but what
    calibration files give.
    """
    config = fill_from_files(config)
    if config.camera.driver != "simulated":
        return config
    truth = config.simulation
    return config.model_copy(
        update={
            "sensor": config.sensor or _simulated_sensor(truth, config.camera),
            "lever": config.lever or _simulated_lever(truth),
            "axes": config.axes or _simulated_axes(truth),
            "pendulum": config.pendulum or _simulated_pendulum(truth),
            "materials": {**_simulated_materials(truth), **config.materials},
            "balance": _simulated_balance(truth, config.balance),
        }
    )


def make_camera(config: Configuration) -> Camera:
    """The configured camera, not opened yet."""
    camera = config.camera
    if camera.driver == "simulated":
        return drivers.make_camera(camera.driver, config.simulation, config.faults)
    if camera.driver == "files":
        if camera.files is None:
            raise ConfigurationError(
                "camera.driver = 'files' needs [camera.files] with a path: --set camera.files.path=FOLDER"
            )
        return drivers.make_camera(camera.driver, camera.files)
    if camera.driver in {"usb3vision", "v4l2", "pylon", "aravis"}:
        settings = getattr(camera, camera.driver)
        serial = settings.serial or camera.serial
        return drivers.make_camera(camera.driver, settings.model_copy(update={"serial": serial}))
    return drivers.make_camera(camera.driver)


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
        return SensorModel(**config.sensor.model_dump())
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
    own = {key: _material(key, value) for key, value in config.materials.items()}
    return material_by_name(name, own)


def _material(name: str, settings: MaterialSettings) -> Material:
    return Material(
        name,
        settings.youngs_modulus_pa,
        settings.poisson_ratio,
        settings.u_youngs_modulus_pa,
        settings.u_poisson_ratio,
    )


def _simulated_sensor(truth: SimulationSettings, camera: CameraSettings) -> SensorSettings:
    depth = (
        truth.sensor.bit_depth
        if camera.pixel_format is None
        else int(camera.pixel_format.removeprefix("mono"))
    )
    state = truth.sensor.at(depth, camera.gain_db or 0.0)
    return SensorSettings(
        gain_e_per_dn=state.gain_e_per_dn,
        read_noise_e=state.read_noise_e,
        full_scale_dn=state.full_scale_dn,
        pedestal_dn=state.black_level_dn,
        prnu=truth.sensor.prnu,
    )


def _simulated_lever(truth: SimulationSettings) -> Lever:
    return Lever(
        arm_m=truth.optics.arm_m,
        pixel_pitch_m=truth.sensor.pixel_pitch_m,
        reference_x_px=truth.optics.reference_x_px,
        reference_y_px=truth.optics.reference_y_px,
    )


def _simulated_axes(truth: SimulationSettings) -> Axes:
    axes = truth.axes
    return Axes(
        slow_angle_rad=axes.slow_angle_rad,
        non_orthogonality_rad=axes.non_orthogonality_rad,
        mirrored=axes.mirrored,
    )


def _simulated_pendulum(truth: SimulationSettings) -> PendulumSettings:
    contact = truth.contact
    return PendulumSettings(
        mass_kg=contact.mass_kg,
        ball_radius_m=contact.ball_radius_m,
        contact_radius_m=contact.contact_radius_m,
        ball_material=SIMULATED_BALL,
        flat_material=SIMULATED_FLAT,
        gravity_m_per_s2=contact.gravity_m_per_s2,
    )


def _simulated_balance(truth: SimulationSettings, balance: BalanceSettings) -> BalanceSettings:
    """Of a rig that is balanced as it is stated: its inertia, and the elasticity that its period shows."""
    if balance.inertia_kg_m2 is not None:
        return balance
    contact = truth.contact
    stiffness_n_m = contact.mass_kg * contact.gravity_m_per_s2 * contact.ball_radius_m
    inertia_kg_m2 = stiffness_n_m * (contact.period0_s / (2.0 * math.pi)) ** 2
    known = {"inertia_kg_m2": inertia_kg_m2, "gamma_pa": contact.gamma_pa, "n": contact.n}
    return balance.model_copy(update=known)


def _simulated_materials(truth: SimulationSettings) -> dict[str, MaterialSettings]:
    contact = truth.contact
    return {
        SIMULATED_BALL: MaterialSettings(
            youngs_modulus_pa=contact.ball_youngs_modulus_pa, poisson_ratio=contact.ball_poisson_ratio
        ),
        SIMULATED_FLAT: MaterialSettings(
            youngs_modulus_pa=contact.flat_youngs_modulus_pa, poisson_ratio=contact.flat_poisson_ratio
        ),
    }


def check_materials(config: Configuration) -> None:
    """Raise ConfigurationError for a material that nobody knows, before anything is measured."""
    if config.pendulum is not None and config.pendulum.contact_radius_m is None:
        try:
            pendulum_on_ball(config)
        except ConfigurationError as error:
            raise ConfigurationError(f"pendulum: {error} under [materials.NAME]") from None


def frame_policy(config: Configuration) -> Policy:
    """Sources that can wait are held back and lose nothing; a real camera cannot wait."""
    if config.camera.driver == "files":
        return "wait"
    return "wait" if config.camera.driver == "simulated" and not config.simulation.real_time else "every"
