"""Units against those of pint, which shares no table with ours."""

import math
from functools import cache

import numpy as np
import pint
import pytest

from processing.errors import ConfigurationError
from processing.units import conversion, nanoseconds, seconds, size, unit_of_name, units_like

IN_PINT = {"px": "pixel", "DN": "count", "°C": "delta_degC", "%": "percent", "e": "elementary_charge"}


@cache
def registry() -> pint.UnitRegistry:
    return pint.UnitRegistry()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("unit", "into"),
    [
        ("mm", "m"),
        ("um", "m"),
        ("µm", "m"),
        ("nm", "m"),
        ("g", "kg"),
        ("mg", "kg"),
        ("GPa", "Pa"),
        ("hPa", "Pa"),
        ("mPa s", "Pa s"),
        ("mJ/m^2", "J/m^2"),
        ("fJ", "J"),
        ("N m", "J"),
        ("W", "kg m^2/s^3"),
        ("ms", "s"),
        ("us", "s"),
        ("min", "s"),
        ("h", "min"),
        ("d", "h"),
        ("arcsec", "rad"),
        ("arcmin", "arcsec"),
        ("deg", "rad"),
        ("mrad", "arcsec"),
        ("deg/min", "rad/s"),
        ("arcsec/min", "rad/s"),
        ("mrad/s^2/sqrt(Hz)", "rad/s^2/sqrt(Hz)"),
        ("%", "1"),
        ("ppm", "%"),
        ("m/s^2/sqrt(Hz)", "m/s**2/Hz^0.5"),
        ("kHz", "1/s"),
        ("m/(s s)", "m/s^2"),
    ],
)
def test_a_factor_is_that_of_pint(unit: str, into: str) -> None:
    def theirs(text: str) -> str:
        return IN_PINT.get(text, text.replace("sqrt(Hz)", "Hz^0.5"))

    expected = registry().Quantity(1.0, theirs(unit)).to(theirs(into)).magnitude
    assert conversion(unit, into) == pytest.approx(expected, rel=1e-14)


@pytest.mark.parametrize(
    ("unit", "into"),
    [
        ("m", "s"),
        ("px", "rad"),
        ("px", "arcsec"),
        ("DN", "px"),
        ("dB", "1"),
        ("°C", "1"),
        ("rad", "1"),
        ("N m", "m"),
    ],
)
def test_what_is_not_the_same_thing_is_refused(unit: str, into: str) -> None:
    with pytest.raises(ConfigurationError, match="not a unit of the same thing"):
        conversion(unit, into)


@pytest.mark.parametrize(
    "text",
    [
        "", "furlong", "m^", "m/(s", "m)", "rad^-p", "5", "m,s", "km2", "mm.", "kmin", "/",
        "m)/(s", ")m(", "m/", "/s", "m//s", "m*/s", "m()", "sqrt()", "m^2^3", "(^2)m",
        "km^999", "m/km^999", "Gm^40", "m^1" + "0" * 400, "m^1.2.3", "(" * 5000 + "m" + ")" * 5000,
    ],
)  # fmt: skip
def test_what_is_no_unit_is_refused(text: str) -> None:
    with pytest.raises(ConfigurationError, match="is not a") as refused:
        size(text)
    assert len(str(refused.value)) < 200


def test_spellings_of_one_unit() -> None:
    assert conversion("J/m²", "J/m^2") == 1.0
    assert size("rad·s⁻¹") == size("rad/s") == size("rad s^-1")
    assert conversion("°", "rad") == math.pi / 180
    assert size("μs") == size("µs") == size("us") == size("usec")


def test_units_of_the_same_thing() -> None:
    assert units_like("rad", ("m", "arcsec", "deg", "s")) == ("arcsec", "deg")


@pytest.mark.parametrize(
    ("name", "unit"),
    [
        ("rotation_rad_per_s", "rad/s"),
        ("air_viscosity_pa_s", "Pa s"),
        ("friction_n_m", "N m"),
        ("gravity_m_per_s2", "m/s^2"),
        ("surface_energy_eq2_j_per_m2", "J/m^2"),
        ("temperature_c", "°C"),
        ("temperature_change_k", "K"),
        ("density_rad_per_s2_rthz", "rad/s^2/sqrt(Hz)"),
        ("u_x_px", "px"),
        ("gain_e_per_dn", "e/DN"),
        ("max_power_w", "W"),
        ("humidity_percent", "%"),
        ("time_ns", "ns"),
        ("contact_radius_m", "m"),
        ("rate_deg_per_min", "deg/min"),
        ("n", ""),
        ("u_n", ""),
        ("c", ""),
        ("u_c", ""),
        ("m", ""),
        ("p_time", ""),
        ("drift_x_per_s", ""),
        ("camera_rate", ""),
        ("index", ""),
        ("value_n", ""),
        ("lines_per_mm", ""),
        ("", ""),
    ],
)
def test_the_unit_that_a_name_ends_in(name: str, unit: str) -> None:
    assert unit_of_name(name) == unit
    assert not unit or size(unit)


def test_numbers_and_arrays_agree_in_every_bit() -> None:
    ticks_ns = np.random.default_rng(1).integers(-(10**17), 10**17, 1000)
    times_s = seconds(ticks_ns)
    assert [seconds(int(tick)) for tick in ticks_ns] == times_s.tolist()
    assert [nanoseconds(float(time)) for time in times_s] == nanoseconds(times_s).tolist()


def test_a_time_becomes_the_nearest_tick() -> None:
    assert [nanoseconds(time_s) for time_s in (0.1 + 0.2, -1.4e-9, 1.6e-9)] == [300_000_000, -1, 2]
    assert nanoseconds(np.array([0.29, 1.6e-9])).tolist() == [290_000_000, 2]
    assert isinstance(nanoseconds(np.float64(0.29)), int)
    assert seconds(1_500_000_000) == 1.5
