"""`rig paper`: the values printed in the paper beside those of its contact pairs, simulated and fitted.

"Phenomenological Laws of Single Point Contact: Pre-Rolling Contact Resistance through Pendulum", Lubricants
2023, 11(2), 88.
"""

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Final, NamedTuple

from acquisition.simulation.settings import ContactTruth, FastModeTruth, ReleaseTruth, SimulationSettings
from acquisition.simulation.true_path import noisy, true_path, true_turning_points
from processing.contact import (
    MATERIALS,
    STANDARD_GRAVITY_M_PER_S2,
    ContactParameters,
    PendulumOnBall,
    contact_radius,
    pendulum_on_ball,
    surface_energy,
)
from processing.deflections import slow_deflections
from processing.estimate import Estimate
from processing.fit import FitMethod, InputQuantity, RigQuantities, fit_asymptotic, fit_exact
from processing.swing import half_cycles_of_blocks, turning_points
from processing.units import ARCSEC_RAD
from rig.analysis import (
    AnalysedRun,
    RunResults,
    Series,
    StoredTurningPoints,
    fitted_series,
    refined_half_cycles,
    with_contact,
)
from rig.settings import FitSettings
from rig.terminal import Table, plain, power, print_line, print_tables, with_uncertainty

MASS_KG: Final = 0.406
BALL_RADIUS_M: Final = 6.05e-3
BALL: Final = "steel"
PARAMETERS: Final = {"b": "b", "p": "p", "c": "c", "n": "n", "period0_s": "T₀", "gamma_pa": "γ"}
B_EXPONENT: Final = -4
"""Power of ten of b, which Table 2 omits: with this one a run lasts as long as stated in the paper."""
NOISE_ARCSEC: Final = 0.0027
"""Standard uncertainty of one tracked position of the demonstration, 0.0055 px at an arm of 1 m."""
_PERIOD_RATIO: Final = 5.0
_FIRST_ARCSEC, _LAST_ARCSEC = 124.0, 2.0
_RUNS: Final = 3


@dataclass(frozen=True, slots=True)
class PrintedPair:
    """Values of one contact pair in Tables 1 to 3."""

    flat_name: str
    flat: str
    contact_radius_um: float
    depth_um: float
    contact_angle_arcmin: float
    b_printed: float
    """b as Table 2 prints it, without its power of ten."""
    p: float
    c: float
    surface_energy_j_per_m2: float
    arae_decay: float
    n: float
    period0_s: float
    gamma_pa: float
    arae_period: float

    @property
    def name(self) -> str:
        return f"{BALL} on {self.flat_name}"

    @property
    def pendulum(self) -> PendulumOnBall:
        return pendulum_on_ball(MASS_KG, BALL_RADIUS_M, MATERIALS[BALL], MATERIALS[self.flat])

    @property
    def parameters(self) -> ContactParameters:
        b = self.b_printed * 10.0**B_EXPONENT
        return ContactParameters(b, self.p, self.c, self.n, self.period0_s, self.gamma_pa)

    @property
    def settings(self) -> SimulationSettings:
        """Settings of the simulated rig with this contact, on ground at rest."""
        flat, ball = MATERIALS[self.flat], MATERIALS[BALL]
        truth = self.parameters
        return SimulationSettings(
            contact=ContactTruth(
                **{name: getattr(truth, name) for name in PARAMETERS},
                mass_kg=MASS_KG,
                ball_radius_m=BALL_RADIUS_M,
                **{f"ball_{name}": value for name, value in asdict(ball).items() if name in _ELASTIC},
                **{f"flat_{name}": value for name, value in asdict(flat).items() if name in _ELASTIC},
            ),
            fast=FastModeTruth(period_ratio=_PERIOD_RATIO),
            release=ReleaseTruth(amplitude_arcsec=_FIRST_ARCSEC),
        )


_ELASTIC: Final = ("youngs_modulus_pa", "poisson_ratio")
PAIRS: Final = (
    PrintedPair(
        "K8 glass", "glass_k8", 66, 0.7, 38,
        37.330, 0.944, 10.510e-9, 28.900e-3, 0.008, 0.092, 4.071, 28.97e6, 0.002,
    ),
    PrintedPair(
        "silicon", "silicon", 59, 0.6, 34,
        7.060, 0.815, 3.840e-9, 13.200e-3, 0.026, 0.552, 4.072, 290.69e6, 0.002,
    ),
    PrintedPair(
        "steel", "steel", 54, 0.5, 31,
        7.961, 0.850, 6.601e-9, 27.300e-3, 0.035, 0.461, 4.049, 95.46e6, 0.004,
    ),
)  # fmt: skip


@dataclass(frozen=True)
class PairSeries:
    """One contact pair, simulated and analysed."""

    pair: PrintedPair
    run: RunResults
    """The first of the runs of `series`."""
    series: Series


def simulate_pair(pair: PrintedPair, seed: int) -> PairSeries:
    """Simulate three runs of a pair, with different noise, make both fits of each, and combine them."""
    pendulum, settings = pair.pendulum, pair.settings
    end_s = float(true_turning_points(settings, _LAST_ARCSEC).time_s[-1])
    motion = true_path(settings, end_s + 0.6 * pair.period0_s)
    noise_rad = NOISE_ARCSEC * ARCSEC_RAD
    rig = RigQuantities(
        InputQuantity(MASS_KG), InputQuantity(BALL_RADIUS_M), MATERIALS[BALL], MATERIALS[pair.flat],
        InputQuantity(1.0), InputQuantity(1.0),
    )  # fmt: skip
    runs = []
    for number in range(_RUNS):
        measured = noisy(motion, noise_rad, noise_rad, seed + number)
        deflections = slow_deflections(measured.times_ns, measured.y_rad, noise_rad)
        half_cycles = half_cycles_of_blocks([deflections])
        refined = refined_half_cycles(half_cycles, [deflections], deflections.unit, pendulum, FitSettings())
        points = turning_points(refined.half_cycles)
        exact = refined.exact or fit_exact(points, pendulum)
        run = AnalysedRun(
            path=Path(),
            record="",
            turning_points=StoredTurningPoints.of(points, refined.half_cycles, deflections.unit, 1.0),
            fitted={
                FitMethod.ASYMPTOTIC: fit_asymptotic(points, pendulum, exact=exact),
                FitMethod.EXACT: exact,
            },
            rig=rig,
        )
        runs.append(with_contact(run, pendulum))
    series = fitted_series(runs)
    assert series is not None  # of several fitted runs
    return PairSeries(pair, runs[0], series)


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
