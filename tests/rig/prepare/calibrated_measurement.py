"""A simulated measurement whose calibrations are made from simulated calibration data only."""

import datetime
from dataclasses import replace
from pathlib import Path

import numpy as np

from acquisition.atomic_write import write_new
from acquisition.simulation.settings import AxesTruth, ContactTruth, FastModeTruth, ReleaseTruth
from acquisition.simulation.true_path import true_path
from calibration.axes_fit import deflections
from calibration.lever_fit import lever_from_tilts
from calibration.store import CalibrationFile, Kind, write_calibration
from processing.deflections import slow_deflections
from processing.fit import points_in_true_time
from processing.fit.exact import fit_exact
from processing.fit.uncertainty import budgets
from processing.swing import half_cycles_of
from processing.units import ARCSEC_RAD
from rig.analysis import refined_half_cycles
from rig.analysis.contact_verdicts import rig_quantities
from rig.instrument import complete, pendulum_on_ball
from rig.settings import Configuration, validate_configuration
from tests.calibration.simulated_rig import (
    Drawn,
    climb_tilts,
    draw_rig,
    spots_of,
    stamp_frames,
    swing_for_axes,
)

STATED = {
    "mass_kg": (0.406, 1e-4),
    "ball_radius_m": (6.05e-3, 2e-6),
}
FINAL_ARCSEC = 4.0
MODULI_PA = {"ball": (2.11e11, 2e9), "flat": (0.82e11, 0.8e9)}


def calibrate(rig: Drawn, folder: Path) -> dict[Kind, Path]:
    """Lever, axes and clock of the drawn rig as files."""
    lever = lever_from_tilts(climb_tilts(rig), rig.settings.sensor.pixel_pitch_m)
    axes = swing_for_axes(rig).axes
    relation = stamp_frames(rig)
    clock = {"camera_rate": relation.rate, "u_camera_rate": relation.u_rate}
    now = datetime.datetime.now(datetime.UTC)
    found: dict[Kind, dict[str, object]] = {
        "lever": lever.model_dump(exclude_none=True),
        "axes": axes.model_dump(),
        "clock": clock,
    }
    return {
        kind: write_calibration(
            folder,
            CalibrationFile(
                kind=kind,
                made_at=now,
                measured_at=now,
                valid_until=now + datetime.timedelta(days=1),
                values=values,
            ),
            write_new,
        )
        for kind, values in found.items()
    }


def measure(seed: int, folder: Path, rate_hz: float = 25.0) -> dict[str, tuple[float, float, float]]:
    """(found, standard uncertainty with the calibration's, truth) of every parameter."""
    rig = draw_rig(seed)
    files = calibrate(rig, folder)
    rng = np.random.default_rng([seed, 909])
    true = {name: value + u * rng.standard_normal() for name, (value, u) in (STATED | MODULI_PA).items()}
    contact = ContactTruth(
        mass_kg=true["mass_kg"],
        ball_radius_m=true["ball_radius_m"],
        ball_youngs_modulus_pa=true["ball"],
        flat_youngs_modulus_pa=true["flat"],
    )
    rig = replace(
        rig,
        settings=rig.settings.model_copy(
            update={
                "contact": contact,
                "release": ReleaseTruth(amplitude_arcsec=124.0),
                "fast": FastModeTruth(amplitude_arcsec=0.3),
                "axes": AxesTruth(**rig.settings.axes.model_dump()),
            }
        ),
    )
    config = complete(_configuration(files))
    assert config.lever is not None
    assert config.axes is not None
    assert config.timebase is not None
    motion = true_path(rig.settings, 1200.0, rate_hz)
    times_s = motion.times_ns * 1e-9
    x_px, y_px = spots_of(rig, motion.x_rad, motion.y_rad, times_s)
    u_px = np.full(len(times_s), rig.noise_px)
    lever = config.lever
    assert lever.reference_x_px is not None
    assert lever.reference_y_px is not None
    _, y_rad, _, u_y_rad = deflections(
        lever, config.axes, x_px, y_px, u_px, u_px, (lever.reference_x_px, lever.reference_y_px)
    )
    stamps_ns = np.rint(times_s * (1 + 1e-6 * rig.settings.clock.drift_ppm) * 1e9).astype(np.int64)
    half_cycles = half_cycles_of(stamps_ns, y_rad, u_y_rad)
    half_cycles = [h for h in half_cycles if h.amplitude > FINAL_ARCSEC * ARCSEC_RAD]
    pendulum, quantities = pendulum_on_ball(config), rig_quantities(config)
    assert pendulum is not None
    assert quantities is not None
    slow, clock_rate = slow_deflections(stamps_ns, y_rad, u_y_rad), config.timebase.camera_rate
    refined = refined_half_cycles(half_cycles, [slow], slow.unit, pendulum, config.fit, clock_rate)
    exact = refined.exact or fit_exact(points_in_true_time(refined.half_cycles, clock_rate), pendulum)
    table = budgets(exact, quantities)
    truth = {name: float(getattr(contact, name)) for name in ("b", "p", "c", "n", "period0_s", "gamma_pa")}
    truth["surface_energy_table2_j_per_m2"] = _surface_energy(contact)
    return {
        name: (table[name].value, table[name].standard_uncertainty, value) for name, value in truth.items()
    }


def _configuration(files: dict[Kind, Path]) -> Configuration:
    """What the analysis is told: stated values, and the calibration files."""
    pendulum: dict[str, object] = {"ball_material": "ball", "flat_material": "flat"}
    for name, (value, u) in STATED.items():
        pendulum |= {name: value, f"u_{name}": u}
    ratios = {"ball": 0.28, "flat": 0.206}
    materials = {
        name: {"youngs_modulus_pa": value, "u_youngs_modulus_pa": u, "poisson_ratio": ratios[name]}
        for name, (value, u) in MODULI_PA.items()
    }
    tree = {
        "camera": {"driver": "simulated"},
        "pendulum": pendulum,
        "materials": materials,
        "calibration": {kind: str(path) for kind, path in files.items()},
    }
    return validate_configuration(tree, "test")


def _surface_energy(contact: ContactTruth) -> float:
    """m g R c/(2 a^2), a after Hertz: written down again, from the truth."""
    softness = (1 - contact.ball_poisson_ratio**2) / contact.ball_youngs_modulus_pa
    softness += (1 - contact.flat_poisson_ratio**2) / contact.flat_youngs_modulus_pa
    force = contact.mass_kg * contact.gravity_m_per_s2
    radius_2 = (0.75 * force * contact.ball_radius_m * softness) ** (2 / 3)
    return force * contact.ball_radius_m * contact.c / (2 * radius_2)
