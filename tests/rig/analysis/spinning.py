"""A simulated pendulum that turns about the vertical, as positions in two directions."""

import math
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import NamedTuple

import numpy as np

from acquisition.simulation.settings import SimulationSettings
from acquisition.simulation.true_path import TruePath, noisy, true_path
from processing.ambient import AmbientConditions
from processing.deflections import Deflections, DeflectionUnit
from processing.swing import HalfCycle, half_cycles_of_blocks
from processing.units import ARCSEC_RAD
from rig.analysis.half_cycle_fits import analyse_swings
from rig.analysis.passing_deflections import PassingDeflections
from rig.analysis.results import RunResults
from rig.analysis.series import AnalysedRun
from rig.analysis.turning_plane import follow_plane
from rig.instrument import complete
from rig.intake.table import TableColumns
from rig.settings import Configuration, load_configuration
from tests.rig.intake.table_cases import analyse_table

FRAMES_PER_S, NOISE_ARCSEC, DURATION_S = 25.0, 0.005, 600.0
DEG_PER_MIN = math.pi / 180.0 / 60.0
DEMONSTRATION = Path(__file__).parents[3] / "configs" / "demo.toml"
EXACT_APPARATUS = tuple(
    f"simulation.stated.{name}=0"
    for name in (
        *("u_mass_kg", "u_ball_radius_m", "u_ball_youngs_modulus_pa", "u_flat_youngs_modulus_pa"),
        *("u_poisson_ratio", "u_arm_m", "u_pixel_pitch_m"),
    )
)
"""Of the demonstration: what is left of its budgets is what the motion leaves."""


@dataclass(frozen=True)
class Spin:
    """A rotation about the vertical, and what disturbs the motion in the axes that turn.

    `rate_rad_per_s` is its rate at the release, which falls exponentially with the time constant `lasts_s`.
    """

    rate_rad_per_s: float = 0.0
    lasts_s: float = math.inf
    leakage: float = 0.002
    fast_arcsec: float = 0.3
    rest_arcsec: tuple[float, float] = (0.0, 0.0)

    def angle_rad(self, time_s: np.ndarray) -> np.ndarray:
        """Angle of the axes from where they were at the release."""
        if math.isinf(self.lasts_s):
            return self.rate_rad_per_s * time_s
        return np.asarray(self.rate_rad_per_s * self.lasts_s * -np.expm1(-time_s / self.lasts_s))


@cache
def _own_path(
    leakage: float, fast_arcsec: float, rest_arcsec: tuple[float, float], duration_s: float
) -> TruePath:
    settings = SimulationSettings.model_validate(
        {
            "fast": {"amplitude_arcsec": fast_arcsec},
            "axes": {
                "leakage": leakage,
                "rest_fast_arcsec": rest_arcsec[0],
                "rest_slow_arcsec": rest_arcsec[1],
            },
        }
    )
    return true_path(settings, duration_s, FRAMES_PER_S)


def positions(
    spin: Spin, seed: int, duration_s: float = DURATION_S, noise_arcsec: float = NOISE_ARCSEC
) -> Deflections:
    """Deflections along axes that stand still."""
    own = _own_path(spin.leakage, spin.fast_arcsec, spin.rest_arcsec, duration_s)
    angle = spin.angle_rad(own.times_ns * 1e-9)
    sine, cosine = np.sin(angle), np.cos(angle)
    still = own._replace(
        x_rad=own.x_rad * cosine + own.y_rad * sine, y_rad=own.y_rad * cosine - own.x_rad * sine
    )
    noise_rad = noise_arcsec * ARCSEC_RAD
    seen = noisy(still, noise_rad, noise_rad, seed)
    u = np.full(len(seen.times_ns), noise_rad)
    return Deflections(seen.times_ns, seen.x_rad, seen.y_rad, u, u, DeflectionUnit.RAD)


def configuration(*overrides: str) -> Configuration:
    """The demonstration's, with an apparatus that is exactly known."""
    return complete(load_configuration(DEMONSTRATION, (*EXACT_APPARATUS, *overrides)))


def passed(seen: Deflections) -> tuple[list[HalfCycle], PassingDeflections]:
    """Half-cycles of deflections, and the deflections in blocks, as they pass from a record."""
    blocks = [seen[first : first + 4096] for first in range(0, len(seen), 4096)]
    return half_cycles_of_blocks(blocks), PassingDeflections(blocks, seen.unit)


def analysed(seen: Deflections, config: Configuration, file: Path) -> AnalysedRun:
    """The results of a record with these deflections; `file` stands for the record."""
    file.touch()
    half_cycles, passing = passed(seen)
    followed = follow_plane(half_cycles, passing, config.axes)
    return analyse_swings(file, followed, config, AmbientConditions())


class Held(NamedTuple):
    """Error over u, and whether one standard uncertainty and the interval that is shown hold the truth."""

    pull: float
    inside: tuple[bool, bool]


def held_by(found: RunResults, name: str, true: float) -> Held:
    """Of a parameter; where only a bound is shown, value and u are those of the exact fit."""
    row = found[name]
    value, u = row if row.determined else found.fits["exact"].estimate(name)
    return Held((value - true) / u, (abs(value - true) < u, not row.lower > true and not row.upper < true))


def analysed_table(seen: Deflections, config: Configuration | None, file: Path) -> RunResults:
    """The results of a table with these positions, in arcsec."""
    rows = np.column_stack([seen.times_s, seen.shown_x, seen.shown_y])
    header = "time_s,x_arcsec,y_arcsec"
    np.savetxt(file, rows, delimiter=",", header=header, comments="", fmt=["%.4f", "%.6f", "%.6f"])
    return analyse_table(file, config, TableColumns()).runs[0]
