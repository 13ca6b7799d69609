"""Numbers as a paper prints them: two digits of the uncertainty, powers of ten, units."""

import math
from collections.abc import Mapping
from typing import Any

_SUPERSCRIPT = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")

SYMBOLS = {
    "b": ("b", "rad⁻ᵖ", 1.0),
    "p": ("p", "1", 1.0),
    "c": ("c", "1", 1.0),
    "n": ("n", "1", 1.0),
    "period0_s": ("T₀", "s", 1.0),
    "gamma_pa": ("γ", "MPa", 1e-6),
    "drag_s": ("drag", "s", 1.0),
    "initial_amplitude_rad": ("α₀", "arcsec", 648000 / math.pi),
    "start_time_s": ("t₀", "s", 1.0),
    "surface_energy_table2_j_per_m2": ("σ (Table 2's form)", "mJ/m²", 1e3),
    "surface_energy_eq2_j_per_m2": ("σ (Eq. 2 as printed)", "mJ/m²", 1e3),
    "contact_radius_m": ("contact radius a", "µm", 1e6),
    "contact_depth_m": ("depth a²/R", "µm", 1e6),
    "contact_angle_rad": ("contact angle a/R", "arcmin", 10800 / math.pi),
}
"""Of every reported quantity: symbol, unit in which it is shown, factor from SI to that unit."""

SOURCES = {
    "swings": "swings (fit)",
    "mass_kg": "mass",
    "ball_radius_m": "ball radius R",
    "gravity_m_per_s2": "local g",
    "arm_m": "lever arm",
    "pitch_m": "pixel pitch",
    "clock": "clock",
    "flat_youngs_modulus_pa": "E of the flat",
    "flat_poisson_ratio": "ν of the flat",
    "ball_youngs_modulus_pa": "E of the ball",
    "ball_poisson_ratio": "ν of the ball",
}


def symbol(name: str) -> tuple[str, str, float]:
    """Symbol, shown unit and factor; an unknown quantity under its own name."""
    return SYMBOLS.get(name, (name, "", 1.0))


def power(exponent: int) -> str:
    """`× 10⁻³`, empty for 0."""
    return f" × 10{str(exponent).translate(_SUPERSCRIPT)}" if exponent else ""


def plain(value: float, digits: int = 4) -> str:
    """A number to some digits; `–` for NaN, which stands for not known."""
    if math.isnan(value):
        return "–"
    if math.isinf(value):
        return "∞" if value > 0 else "−∞"
    if value == 0:
        return "0"
    exponent = math.floor(math.log10(abs(value)))
    if -3 <= exponent < max(digits, 5):
        return f"{value:.{max(0, digits - 1 - exponent)}f}".replace("-", "−")
    return f"{value / 10.0**exponent:.{digits - 1}f}".replace("-", "−") + power(exponent)


def with_uncertainty(value: float, u: float) -> str:
    """`(3.73315 ± 0.00010) × 10⁻³`: to two digits of the standard uncertainty."""
    if not math.isfinite(value):
        return "not determined"
    if not math.isfinite(u) or u <= 0:
        return plain(value, 5)
    exponent = math.floor(math.log10(max(abs(value), u)))
    shift = 0 if -3 < exponent <= 4 else exponent
    # rounding to two digits can carry: 0.0996 is 0.10
    first = math.floor(math.log10(float(f"{u / 10.0**shift:.1e}")))
    digits = max(0, 1 - first)
    text = f"{value / 10.0**shift:.{digits}f} ± {u / 10.0**shift:.{digits}f}".replace("-", "−")
    return f"({text}){power(shift)}" if shift else text


def number(tree: Mapping[str, Any], name: str, key: str = "value") -> float:
    """A value of results.json as a float, NaN where it is null or not there."""
    entry = tree.get(name)
    value = entry.get(key) if isinstance(entry, Mapping) else entry
    return float(value) if isinstance(value, int | float) else math.nan
