"""Tables that compare the paper's printed values with simulated and analysed ones."""

import math
from collections.abc import Sequence
from typing import Final, NamedTuple

from processing.contact import MATERIALS, STANDARD_GRAVITY_M_PER_S2, contact_radius, surface_energy
from processing.estimate import Estimate
from processing.fit import FitMethod
from rig.report.paper_simulation import (
    B_EXPONENT,
    BALL,
    BALL_RADIUS_M,
    MASS_KG,
    PAIRS,
    PARAMETERS,
    PairSeries,
    PrintedPair,
    simulate_pair,
)
from rig.terminal import Table, plain, power, print_line, print_tables, with_uncertainty

CONTRADICTION: Final = "known contradiction"
_AGREES: Final = "agrees"
_SEED: Final = 1
_EXACT, _ASYMPTOTIC = FitMethod.EXACT, FitMethod.ASYMPTOTIC
_FITS_HEAD: Final = (_EXACT.heading, "difference", _ASYMPTOTIC.heading, "difference", "verdict")
CONTRADICTIONS: Final = (
    (
        "Table 2's first row is printed without label and unit: it is b without its power of ten. "
        "The row labelled b is p."
    ),
    (
        "Eq. 2 as printed, σ = m g c/(2a), gives a hundredth of Table 2's surface energies; m g R c/(2a²) "
        "gives 28.90, 13.21 and 27.22 mJ/m², Table 2's within 0.3 %. Both are reported."
    ),
    (
        "Eq. 6 prints 0.55 where averaging Eq. 3 gives a factor that depends on n (0.540 at n = 0); "
        "here it is calculated."
    ),
    "Eqs. 8 and 9 sum k + 1 terms and divide by k; here the mean is taken.",
    (
        "Eqs. 5 and 6 are asymptotic: fitted to swings that obey the paper's own laws they return b, c and "
        "γ that are off, by some per cent if b's power of ten is -4 (columns of Tables 2 and 3); the "
        "relative errors of Eqs. 8 and 9 do not show it. The exact map is not off."
    ),
    "Table 4 draws its loops and states its works in pictures only: there is no printed number to compare.",
)


def reproduce_paper() -> None:
    """Simulate and analyse three runs of each contact pair; print Tables 1 to 3 beside the paper's."""
    results = [simulate_pair(pair, _SEED + 1000 * number) for number, pair in enumerate(PAIRS, start=1)]
    friction = [row for series in results for row in friction_rows(series)]
    elastic = [row for series in results for row in elastic_rows(series)]
    table2 = _comparison_table("table2", "Table 2: friction", friction)
    table3 = _comparison_table("table3", "Table 3: elastic rolling resistance", elastic)
    print_tables([table1(), table2, table3])
    print_line("Known contradictions of the printed text:")
    for line in CONTRADICTIONS:
        print_line(f"- {line}")


def table1() -> Table:
    """Table 1: the contact by Hertz's theory, calculated from the materials."""
    lines = []
    load_n = MASS_KG * STANDARD_GRAVITY_M_PER_S2
    for pair in PAIRS:
        radius_m = contact_radius(load_n, BALL_RADIUS_M, MATERIALS[BALL], MATERIALS[pair.flat])
        angle_arcmin = math.degrees(radius_m / BALL_RADIUS_M) * 60
        for index, (name, unit, printed, value, last_digit) in enumerate((
            ("contact radius", "µm", pair.contact_radius_um, radius_m * 1e6, 1.0),
            ("depth", "µm", pair.depth_um, radius_m**2 / BALL_RADIUS_M * 1e6, 0.1),
            ("contact angle", "arcmin", pair.contact_angle_arcmin, angle_arcmin, 1.0),
        )):  # fmt: skip
            verdict = _agreement(value - printed, 0.0, last_digit) or "differs"
            flat, label = "" if index else pair.flat_name, f"{name} / {unit}"
            difference = _percent(value / printed - 1)
            lines.append([flat, label, f"{printed:g}", plain(value, 4), difference, verdict])
    head = ("", "", "printed", "calculated", "difference", "verdict")
    return Table("table1", "Table 1: contact after Hertz", head, lines)


def friction_rows(series: PairSeries) -> list["PrintedRow"]:
    """A pair's rows of Table 2, friction: b, p, c, surface energy in both forms, ARAE."""
    b_note = f"with the power of ten set to {B_EXPONENT}, which the paper leaves out"
    unit, scale = f"{power(B_EXPONENT)} rad⁻ᵖ", 10.0**B_EXPONENT
    return [
        _fitted_row(series, "b", unit, series.pair.b_printed, scale, note=b_note),
        _fitted_row(series, "p", "1", series.pair.p, note="printed in the row labelled b"),
        _fitted_row(series, "c", power(-9), series.pair.c * 1e9, 1e-9),
        _energy(series, "table2"),
        _energy(series, "eq2"),
        _arae(series, "arae_decay", "ARAE, Eq. 8"),
    ]


def elastic_rows(series: PairSeries) -> list["PrintedRow"]:
    """A pair's rows of Table 3, elastic rolling resistance: n, T0, gamma, ARAE."""
    return [
        _fitted_row(series, "n", "1", series.pair.n),
        _fitted_row(series, "period0_s", "s", series.pair.period0_s),
        _fitted_row(series, "gamma_pa", "MPa", series.pair.gamma_pa * 1e-6, 1e6, last_digit=0.01),
        _arae(series, "arae_period", "ARAE, Eq. 9"),
    ]


class PrintedRow(NamedTuple):
    """A printed value beside the values of both fits."""

    pair: PrintedPair
    label: str
    unit: str
    printed: float
    exact: float
    u: float
    """Standard uncertainty of `exact`; NaN if it cannot be compared with the printed value."""
    asymptotic: float
    verdict: str
    note: str = ""

    @property
    def differences(self) -> tuple[float, float]:
        """Relative differences of both fits; NaN if values are not comparable."""
        if math.isnan(self.u):
            return math.nan, math.nan
        return self.exact / self.printed - 1, self.asymptotic / self.printed - 1


def _fitted_row(
    series: PairSeries, parameter: str, unit: str, printed: float, scale: float = 1.0,
    last_digit: float = 0.001, note: str = "",
) -> PrintedRow:  # fmt: skip
    """Row of one fitted parameter: it agrees within its 95 % interval, or within the paper's rounding."""
    exact, asymptotic = (series.series.fits[method][parameter] for method in (_EXACT, _ASYMPTOTIC))
    value, u = exact.value / scale, exact.standard_uncertainty / scale
    difference = value - printed
    verdict = _agreement(difference, exact.expanded_uncertainty_95 / scale, last_digit)
    verdict = verdict or f"differs by {abs(difference) / u:.1f} u"
    values = (printed, value, u, asymptotic.value / scale)
    return PrintedRow(series.pair, PARAMETERS[parameter], unit, *values, verdict, note=note)


def _agreement(difference: float, half_width: float, last_digit: float) -> str:
    """Words for agreement within the 95 % half-width or the rounding; empty if a value disagrees."""
    if abs(difference) <= half_width:
        return f"{_AGREES} (95 %)"
    return f"{_AGREES} as rounded" if abs(difference) <= 0.5 * last_digit else ""


def _energy(series: PairSeries, form: str) -> PrintedRow:
    """Row of the surface energy: the form of Table 2 must agree, Eq. 2 as printed is known to differ."""
    printed = series.pair.surface_energy_j_per_m2 * 1e3
    exact, asymptotic = (series.series.fits[method]["c"] for method in (_EXACT, _ASYMPTOTIC))
    value, u = (
        1e3 * number for number in getattr(surface_energy(exact.estimate, series.pair.pendulum), form)
    )
    values = (printed, value, u, value / exact.value * asymptotic.value)
    if form == "eq2":
        verdict = f"{CONTRADICTION} with Table 2"
        return PrintedRow(series.pair, "σ, Eq. 2: m g c/(2a)", "mJ/m²", *values, verdict)
    half_width = u * exact.expanded_uncertainty_95 / exact.standard_uncertainty
    of_printed_c = surface_energy(Estimate(series.pair.c, 0.0), series.pair.pendulum).table2.value * 1e3
    verdict = _agreement(value - printed, half_width, 0.1)
    if not verdict and abs(value - of_printed_c) <= half_width:
        difference = f"{100 * abs(printed / of_printed_c - 1):.1f} %"
        verdict = f"{_AGREES} with the printed c (σ {of_printed_c:.2f}, {difference} off)"
    verdict = verdict or f"differs by {abs(value - printed) / u:.1f} u"
    return PrintedRow(series.pair, "σ, m g R c/(2a²)", "mJ/m²", *values, verdict)


def _arae(series: PairSeries, key: str, label: str) -> PrintedRow:
    """Row of a relative error, which is not comparable, because it depends on the noise."""
    printed = getattr(series.pair, key)
    exact, asymptotic = (float(getattr(series.run.fits[method], key)) for method in (_EXACT, _ASYMPTOTIC))
    values = (printed, exact, math.nan, asymptotic)
    return PrintedRow(series.pair, label, "1", *values, "not comparable: another noise")


def _comparison_table(name: str, title: str, rows: Sequence[PrintedRow]) -> Table:
    lines = []
    previous: PrintedPair | None = None
    for row in rows:
        without_u, differences = math.isnan(row.u), [_percent(share) for share in row.differences]
        texts = [
            row.pair.flat_name if row.pair is not previous else "",
            f"{row.label} / {row.unit.removeprefix(' × ')}" if row.unit != "1" else row.label,
            f"{row.printed:.6g}",
            plain(row.exact, 2) if without_u else with_uncertainty(row.exact, row.u),
            differences[0], plain(row.asymptotic, 2 if without_u else 5), differences[1], row.verdict,
        ]  # fmt: skip
        lines.append(texts)
        previous = row.pair
    notes = dict.fromkeys(f"{row.label}: {row.note}. " for row in rows if row.note)
    return Table(name, title, ("", "", "printed", *_FITS_HEAD), lines, "".join(notes).rstrip())


def _percent(share: float) -> str:
    if math.isnan(share):
        return "–"
    if abs(share) < 5e-6:
        return "0.000 %"
    digits = 1 if abs(share) >= 0.1 else 2 if abs(share) >= 0.001 else 3
    return f"{100 * share:+.{digits}f} %".replace("-", "−")
