"""Tables that compare the paper's printed values with those from simulation and analysis."""

import math
from collections.abc import Sequence
from typing import NamedTuple

from processing.angle import ARCSEC_RAD
from processing.contact import (
    MATERIALS,
    STANDARD_GRAVITY_M_PER_S2,
    ContactParameters,
    cycle_work,
    hertz_contact,
    surface_energy,
)
from processing.contact.laws import PAPER
from processing.estimate import Estimate
from processing.fit import FitMethod
from rig.paper.printed import BALL, BALL_RADIUS_M, LOOP_AMPLITUDE_ARCSEC, MASS_KG, PAIRS, PrintedPair
from rig.paper.simulation import PairSeries
from rig.presentation import Cell, Table, plain, power, with_uncertainty

AGREES = "agrees"
CONTRADICTION = "known contradiction"
NOT_COMPARABLE = "not comparable"
_DIFFERENCES = (f"relative_difference_{FitMethod.EXACT}", f"relative_difference_{FitMethod.ASYMPTOTIC}")
_COLUMNS = (
    "pair", "quantity", "unit", "printed", FitMethod.EXACT, f"u_{FitMethod.EXACT}", FitMethod.ASYMPTOTIC,
    *_DIFFERENCES, "verdict",
)  # fmt: skip
_FITS_HEAD = (
    FitMethod.EXACT.heading, "difference", FitMethod.ASYMPTOTIC.heading, "difference", "verdict",
)  # fmt: skip
_HEAD = ("", "", "printed", *_FITS_HEAD)


_BOTH = (FitMethod.EXACT, FitMethod.ASYMPTOTIC)


def table1() -> Table:
    """Contact according to Hertz, calculated from the materials, without simulation."""
    rows: list[list[Cell]] = []
    shown = []
    for pair in PAIRS:
        contact = hertz_contact(
            MASS_KG * STANDARD_GRAVITY_M_PER_S2, BALL_RADIUS_M, MATERIALS[BALL], MATERIALS[pair.flat]
        )
        name = pair.flat_name
        for what, unit, printed, found, last_digit in (
            ("contact radius", "µm", pair.contact_radius_um, contact.radius_m.value * 1e6, 1.0),
            ("depth", "µm", pair.depth_um, contact.depth_m.value * 1e6, 0.1),
            (
                "contact angle",
                "arcmin",
                pair.contact_angle_arcmin,
                math.degrees(contact.angle_rad.value) * 60,
                1.0,
            ),
        ):
            agrees = abs(found - printed) <= 0.5 * last_digit
            verdict = f"{AGREES} as rounded" if agrees else "differs"
            difference = found / printed - 1
            rows.append([pair.name, what, unit, printed, found, difference, verdict])
            shown.append(
                [name, f"{what} / {unit}", f"{printed:g}", plain(found, 4), _percent(difference), verdict]
            )
            name = ""
    return Table(
        "table1", "Table 1: contact after Hertz",
        ("pair", "quantity", "unit", "printed", "calculated", "relative_difference", "verdict"), rows,
        ("", "", "printed", "calculated", "difference", "verdict"), shown,
    )  # fmt: skip


def table2(found: Sequence[PairSeries], b_exponent: int) -> Table:
    """Friction: b, p, c, surface energy in both forms, ARAE; `b_exponent` is the power of ten of b."""
    rows: list[_Compared] = []
    for series in found:
        pair = series.pair
        left_out = f"with the power of ten set to {b_exponent}, which the paper leaves out"
        rows += [
            _fitted(
                series, "b", f"{power(b_exponent)} rad⁻ᵖ", pair.b_printed, 10.0**b_exponent, 0.001, left_out
            ),
            _fitted(series, "p", "1", pair.p, 1.0, 0.001, "printed in the row labelled b"),
            _fitted(series, "c", power(-9), pair.c * 1e9, 1e-9, 0.001),
        ]
        rows += [_energy(series, "table2"), _energy(series, "eq2")]
        rows.append(_arae(series, "arae_decay", pair.arae_decay))
    return _compared("table2", "Table 2: friction", rows)


def table3(found: Sequence[PairSeries]) -> Table:
    """Elastic rolling resistance: n, T0, gamma, ARAE."""
    rows: list[_Compared] = []
    for series in found:
        pair = series.pair
        rows.append(_fitted(series, "n", "1", pair.n, 1.0, 0.001))
        rows.append(_fitted(series, "period0_s", "s", pair.period0_s, 1.0, 0.001))
        rows.append(_fitted(series, "gamma_pa", "MPa", pair.gamma_pa * 1e-6, 1e6, 0.01))
        rows.append(_arae(series, "arae_period", pair.arae_period))
    return _compared("table3", "Table 3: elastic rolling resistance", rows)


def table4(found: Sequence[PairSeries]) -> Table:
    """Work over one cycle, with the printed and with the fitted parameters."""
    rows: list[list[Cell]] = []
    shown = []
    for series in found:
        name = series.pair.flat_name
        amplitude_rad = LOOP_AMPLITUDE_ARCSEC * ARCSEC_RAD
        truth = cycle_work(amplitude_rad, series.parameters, series.pendulum)
        fitted = cycle_work(amplitude_rad, _contact(series, FitMethod.EXACT), series.pendulum)
        paper = cycle_work(amplitude_rad, _contact(series, FitMethod.ASYMPTOTIC), series.pendulum)
        for what, attribute in (("4A", "dissipated_j"), ("4Aₜ", "adhesive_j")):
            expected, exact, way = (getattr(work, attribute) * 1e15 for work in (truth, fitted, paper))
            rows.append(
                [series.pair.name, what, "fJ", expected, exact, way, exact / expected - 1, way / expected - 1]
            )
            shown.append(
                [
                    name, f"{what} / fJ", plain(expected), plain(exact), _percent(exact / expected - 1),
                    plain(way), _percent(way / expected - 1), "no printed number",
                ]
            )  # fmt: skip
            name = ""
    return Table(
        "table4", f"Table 4: work over one cycle at {LOOP_AMPLITUDE_ARCSEC:g} arcsec",
        ("pair", "quantity", "unit", "of_printed_parameters", FitMethod.EXACT, FitMethod.ASYMPTOTIC,
         *_DIFFERENCES),
        rows,
        ("", "", "of printed parameters", *_FITS_HEAD),
        shown,
    )  # fmt: skip


def _contact(series: PairSeries, method: FitMethod) -> ContactParameters:
    """The combined parameters of a series, as arguments of the contact laws."""
    found = series.series.fits[method]
    return ContactParameters(**{name: found[name].value for name in PAPER.names()})


class _Compared(NamedTuple):
    """A printed value beside the fitted ones; `remark` stands behind the verdict, `note` below the table."""

    pair: PrintedPair
    label: str
    unit: str
    printed: float
    exact: float
    u: float
    other: float
    difference: float
    other_difference: float
    verdict: str
    remark: str = ""
    note: str = ""


def _fitted(
    series: PairSeries,
    parameter: str,
    unit: str,
    printed: float,
    scale: float,
    last_digit: float,
    note: str = "",
) -> _Compared:
    """Row of one fitted parameter: it agrees within its 95 % interval, or within the rounding of the
    paper.
    """
    exact, asymptotic = (series.series.fits[method][parameter] for method in _BOTH)
    value, u = exact.value / scale, exact.standard_uncertainty / scale
    half, other = exact.expanded_uncertainty_95 / scale, asymptotic.value / scale
    difference = value - printed
    verdict = _agreement(difference, half, last_digit) or f"differs by {abs(difference) / u:.1f} u"
    label = {"period0_s": "T₀", "gamma_pa": "γ"}.get(parameter, parameter)
    differences = value / printed - 1, other / printed - 1
    return _Compared(series.pair, label, unit, printed, value, u, other, *differences, verdict, note=note)


def _agreement(difference: float, half: float, last_digit: float) -> str:
    """How a value agrees with a printed one, by its 95 % half-width or as rounded; empty if it does not."""
    if abs(difference) <= half:
        return f"{AGREES} (95 %)"
    return f"{AGREES} as rounded" if abs(difference) <= 0.5 * last_digit else ""


def _energy(series: PairSeries, form: str) -> _Compared:
    """Row of the surface energy: the form used in Table 2 must agree, Eq. 2 as printed is known to differ."""
    printed = series.pair.surface_energy_j_per_m2 * 1e3
    exact, asymptotic = (series.series.fits[method]["c"] for method in _BOTH)
    energy = surface_energy(exact.estimate, series.pendulum)
    value, u = (1e3 * number for number in (energy.table2 if form == "table2" else energy.eq2))
    other = value / exact.value * asymptotic.value
    label = "σ, m g R c/(2a²)" if form == "table2" else "σ, Eq. 2: m g c/(2a)"
    half = u * exact.expanded_uncertainty_95 / exact.standard_uncertainty
    of_printed_c = surface_energy(Estimate(series.pair.c, 0.0), series.pendulum).table2.value * 1e3
    agrees = _agreement(value - printed, half, 0.1)
    if form == "eq2":
        verdict = CONTRADICTION
    elif agrees:
        verdict = agrees
    elif abs(value - of_printed_c) <= half:
        off = f"{100 * abs(printed / of_printed_c - 1):.1f} %"
        verdict = f"{AGREES} with the printed c (σ {of_printed_c:.2f}, {off} off)"
    else:
        verdict = f"differs by {abs(value - printed) / u:.1f} u"
    return _Compared(
        series.pair, label, "mJ/m²", printed, value, u, other, value / printed - 1, other / printed - 1,
        verdict, "" if form == "table2" else " with Table 2",
    )  # fmt: skip


def _arae(series: PairSeries, key: str, printed: float) -> _Compared:
    """Row of a relative error, which is not comparable: it depends on the noise, which is that of the
    simulation.
    """
    values = [float(getattr(series.run.fits[method], key)) for method in _BOTH]
    label = "ARAE, Eq. 8" if key == "arae_decay" else "ARAE, Eq. 9"
    return _Compared(
        series.pair, label, "1", printed, values[0], math.nan, values[1], math.nan, math.nan,
        NOT_COMPARABLE, ": another noise",
    )  # fmt: skip


def _compared(name: str, title: str, rows: Sequence[_Compared]) -> Table:
    shown = []
    before: PrintedPair | None = None
    for row in rows:
        without_u = math.isnan(row.u)
        shown.append(
            [
                row.pair.flat_name if row.pair is not before else "",
                f"{row.label} / {row.unit.removeprefix(' × ')}" if row.unit != "1" else row.label,
                f"{row.printed:.6g}",
                plain(row.exact, 2) if without_u else with_uncertainty(row.exact, row.u),
                _percent(row.difference),
                plain(row.other, 2 if without_u else 5),
                _percent(row.other_difference),
                f"{row.verdict}{row.remark}",
            ]
        )
        before = row.pair
    notes = dict.fromkeys(f"{row.label}: {row.note}" for row in rows if row.note)
    cells: list[list[Cell]] = [[row.pair.name, *row[1:-2]] for row in rows]
    return Table(name, title, _COLUMNS, cells, _HEAD, shown, "".join(f"{note}. " for note in notes).rstrip())


def _percent(share: float) -> str:
    if math.isnan(share):
        return "–"
    if abs(share) < 5e-6:
        return "0.000 %"
    digits = 1 if abs(share) >= 0.1 else 2 if abs(share) >= 0.001 else 3
    return f"{100 * share:+.{digits}f} %".replace("-", "−")
