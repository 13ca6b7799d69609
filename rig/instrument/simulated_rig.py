"""Fills missing sections of a configuration from calibration files or from the simulated rig."""

import math
from dataclasses import replace

from acquisition.simulation.settings import SimulationSettings
from calibration import Axes, Lever, Shutter
from processing.contact import Material
from processing.spot import SensorModel
from rig.instrument.calibration import fill_from_files
from rig.settings import BalanceSettings, Configuration, PendulumSettings

SIMULATED_BALL = "simulated_ball"
SIMULATED_FLAT = "simulated_flat"


def fill_from_truth(config: Configuration) -> Configuration:
    """Fill sensor, shutter, lever, axes, pendulum, materials and balance if they are not stated.

    The calibration is then perfect: ``--set simulation...`` changes the simulated apparatus and the
    values that the analysis uses for it together.
    """
    truth = config.simulation
    return config.model_copy(
        update={
            "sensor": config.sensor or _sensor(truth, config),
            "shutter": config.shutter or _shutter(truth, config.camera.binning or 1),
            "lever": config.lever or _lever(truth),
            "axes": config.axes or _axes(truth),
            "pendulum": config.pendulum or _pendulum(truth),
            "materials": {**_materials(truth), **config.materials},
            "balance": _balance(truth, config.balance),
        }
    )


def _sensor(truth: SimulationSettings, config: Configuration) -> SensorModel:
    camera = config.camera
    depth = (
        truth.sensor.bit_depth
        if camera.pixel_format is None
        else int(camera.pixel_format.removeprefix("mono"))
    )
    binning = camera.binning or 1
    state = truth.sensor.at(depth, camera.gain_db or 0.0).binned(binning)
    return SensorModel(
        gain_e_per_dn=state.gain_e_per_dn,
        read_noise_e=state.read_noise_e,
        full_scale_dn=state.full_scale_dn,
        pedestal_dn=state.black_level_dn,
        prnu=truth.sensor.prnu / binning,
    )


def _shutter(truth: SimulationSettings, binning: int) -> Shutter | None:
    """None for a global shutter, which needs no correction."""
    sensor = truth.sensor
    return Shutter(sensor.row_time_s * binning, first_row=sensor.first_row) if sensor.row_time_s else None


def _lever(truth: SimulationSettings) -> Lever:
    return Lever(
        arm_m=truth.optics.arm_m,
        u_arm_m=truth.stated.u_arm_m,
        pixel_pitch_m=truth.sensor.pixel_pitch_m,
        u_pixel_pitch_m=truth.stated.u_pixel_pitch_m,
        reference_x_px=truth.optics.reference_x_px,
        reference_y_px=truth.optics.reference_y_px,
    )


def _axes(truth: SimulationSettings) -> Axes:
    axes = truth.axes
    return Axes(
        slow_angle_rad=axes.slow_angle_rad,
        non_orthogonality_rad=axes.non_orthogonality_rad,
        mirrored=axes.mirrored,
    )


def _pendulum(truth: SimulationSettings) -> PendulumSettings:
    contact, ground, stated = truth.contact, truth.ground, truth.stated
    return PendulumSettings(
        mass_kg=contact.mass_kg,
        u_mass_kg=stated.u_mass_kg,
        ball_radius_m=contact.ball_radius_m,
        u_ball_radius_m=stated.u_ball_radius_m,
        contact_radius_m=contact.contact_radius_m,
        ball_material=SIMULATED_BALL,
        flat_material=SIMULATED_FLAT,
        mass_centre_height_m=None if ground.model == "none" else ground.mass_centre_height_m,
        gravity_m_per_s2=contact.gravity_m_per_s2,
        u_gravity_m_per_s2=stated.u_gravity_m_per_s2,
    )


def _balance(truth: SimulationSettings, balance: BalanceSettings) -> BalanceSettings:
    """Add the inertia about the contact that gives the stated period, and the elasticity of the contact."""
    if balance.inertia_kg_m2 is not None:
        return balance
    contact = truth.contact
    stiffness_n_m = contact.mass_kg * contact.gravity_m_per_s2 * contact.ball_radius_m
    inertia_kg_m2 = stiffness_n_m * (contact.period0_s / (2.0 * math.pi)) ** 2
    return replace(balance, inertia_kg_m2=inertia_kg_m2, gamma_pa=contact.gamma_pa, n=contact.n)


def _materials(truth: SimulationSettings) -> dict[str, Material]:
    contact, stated = truth.contact, truth.stated
    return {
        SIMULATED_BALL: Material(
            contact.ball_youngs_modulus_pa,
            contact.ball_poisson_ratio,
            stated.u_ball_youngs_modulus_pa,
            stated.u_poisson_ratio,
        ),
        SIMULATED_FLAT: Material(
            contact.flat_youngs_modulus_pa,
            contact.flat_poisson_ratio,
            stated.u_flat_youngs_modulus_pa,
            stated.u_poisson_ratio,
        ),
    }


def complete(config: Configuration) -> Configuration:
    """Fill missing sections from calibration files and from the true values of a simulated rig.

    The lever becomes that of the camera's binning and colour plane.
    """
    config = fill_from_files(_binned(config))
    return _binned(fill_from_truth(config)) if config.simulated else config


def _binned(config: Configuration) -> Configuration:
    if config.lever is None:
        return config
    return config.model_copy(update={"lever": config.lever.at_binning(config.camera.pitch_factor)})
