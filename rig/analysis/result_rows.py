"""The table of results: one row for every quantity, made once, and read by every output."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from math import exp, floor, hypot, inf, isfinite, isnan, log, log10, nan
from types import MappingProxyType
from typing import Annotated, Final

from processing.contact import DRAG, PendulumOnBall, surface_energy
from processing.errors import ConfigurationError
from processing.estimate import NOT_DETERMINED, WELL_DETERMINED, Determinacy, Estimate
from processing.fit import Budget, Determination, FitMethod, FitResult
from processing.quantity import OF, Quantity
from processing.series import CombinedValue, combined_limits
from rig.terminal import QuantityDisplay, interval, law_parameters, plain, quantity, unit_of

SURFACE_ENERGY: Final = "surface_energy_table2_j_per_m2"
ENERGIES: Final = (SURFACE_ENERGY, "surface_energy_eq2_j_per_m2")
_SHORT_NAMES: Final = {
    "T0": "period0_s",
    "gamma": "gamma_pa",
    "sigma": SURFACE_ENERGY,
    "drag": DRAG.key,
    "a": "contact_radius_m",
}
_MAX_LOGARITHMIC_U: Final = 3.0
"""Largest relative uncertainty by the apparatus that is added in the logarithm of a parameter."""
_NORMAL_95: Final = 1.959964
_MAX_NONPARABOLIC_SHIFT: Final = 0.25
"""Largest difference between the limits of a run and those of a parabola, over their half-width, at which a
mean of runs is formed. Student's t alone makes a sixth in a run of ten half-cycles."""
_QUANTITY_UNIT = Quantity("", "", unit=OF + "quantity")


@dataclass(frozen=True, slots=True, kw_only=True, repr=False)
class ResultRow:
    """One quantity of a run or a series; it unpacks: ``value, u_total = row``."""

    quantity: str
    fit: str = FitMethod.EXACT.value
    """Source of the row: the exact fit, another fit, the decay alone, a theory of adhesion."""
    value: Annotated[float, _QUANTITY_UNIT] = nan
    """The value; like `u` and `u_total`, NaN unless the data determine the quantity."""
    u: Annotated[float, _QUANTITY_UNIT] = nan
    """Standard uncertainty of the half-cycles alone."""
    u_total: Annotated[float, _QUANTITY_UNIT] = nan
    """Standard uncertainty of half-cycles and apparatus together."""
    lower: Annotated[float, _QUANTITY_UNIT] = nan
    """Lower end of the 95 % interval of both together; NaN if the data set none."""
    upper: Annotated[float, _QUANTITY_UNIT] = nan
    """Upper end of this interval; NaN if the data set none."""
    verdict: Determinacy = Determinacy.DETERMINED
    unit: str = ""
    """Unit of the numbers."""
    run: str = ""
    """Name of the run; "series" for several runs together."""
    by_profile: bool = False
    """Whether the interval is by the profile likelihood, else by the covariance."""

    def __iter__(self) -> Iterator[float]:
        return iter((self.value, self.u_total))

    @property
    def determined(self) -> bool:
        """Whether the quantity has a value with an uncertainty."""
        return self.verdict is Determinacy.DETERMINED

    @property
    def shown(self) -> QuantityDisplay:
        """Symbol, unit and factor with which it is shown."""
        return quantity(self.quantity)

    @property
    def text(self) -> str:
        """Value and whole uncertainty in the unit shown, or the interval or bound."""
        return self.shown.text(*self) if self.determined else self.scaled_text(self.shown.factor)

    def scaled_text(self, scale: float) -> str:
        """Interval or bound of `scale` times the quantity."""
        low, high = self.lower * scale, self.upper * scale
        match self.verdict:
            case Determinacy.UPPER_BOUND:
                return f"< {plain(high, 2)} (95 %)"
            case Determinacy.LOWER_BOUND if low > 0:
                # rounded down: the nearest number might lie above the limit
                digit = 10.0 ** (floor(log10(low)) - 2)
                return f"> {plain(low - 0.5 * digit, 3)} (95 %)"
            case Determinacy.INTERVAL | Determinacy.DETERMINED:
                return f"{interval(low, high)} (95 %)"
        return "not determined"

    @property
    def interval_text(self) -> str:
        """The 95 % interval in the unit shown."""
        return interval(self.lower * self.shown.factor, self.upper * self.shown.factor)

    @property
    def equation(self) -> str:
        """An equation such as ``b = (3.73 ± 0.02) × 10⁻³ rad⁻ᵖ`` or ``c < 1.4 × 10⁻⁸ (95 %)``."""
        sign = {Determinacy.DETERMINED: "= ", Determinacy.INTERVAL: "in "}.get(self.verdict, "")
        return f"{self.shown.symbol} {sign}{self.text} {self.shown.unit}".rstrip()

    def __str__(self) -> str:
        return self.equation

    def __repr__(self) -> str:
        return f"<{self.equation}>"


def named(key: str) -> str:
    """The label of a quantity at its first mention: a surface energy with its name."""
    label = quantity(key).label
    return f"surface energy {label}" if key in ENERGIES else label


def plain_row(
    name: str, estimate: Estimate | float, run: str, fit: str = FitMethod.EXACT.value, unit: str = ""
) -> ResultRow:
    """The row of a number, or of a value with its standard uncertainty."""
    value, u = estimate if isinstance(estimate, Estimate) else (estimate, nan)
    return ResultRow(quantity=name, fit=fit, value=value, u=u, u_total=u, unit=unit or unit_of(name), run=run)


def result_rows(
    run: str,
    fit: FitResult,
    determinations: Sequence[Determination],
    budget: Mapping[str, Budget],
    pendulum: PendulumOnBall,
) -> tuple[ResultRow, ...]:
    """The rows of one run: fitted parameters, surface energies, and quantities by the apparatus alone.

    A parameter without a determination (its profile failed) is withheld, unless its relative uncertainty is
    so small that it needs none.
    """
    by_name = {determination.name: determination for determination in determinations}
    parameters = []
    for name in fit.contact_names:
        estimate, verdict, ends = fit.estimate(name), Determinacy.UNDETERMINED, (nan, nan)
        if estimate.standard_uncertainty <= WELL_DETERMINED * abs(estimate.value):
            verdict, ends = Determinacy.DETERMINED, fit.interval(name)
        parameters.append((estimate, by_name.get(name) or Determination(name, verdict, *ends)))
    return _with_apparatus(run, parameters, budget, pendulum)


def rows_of_others(
    run: str, fits: Mapping[str, FitResult], rows: Sequence[ResultRow]
) -> tuple[ResultRow, ...]:
    """The rows of a run's fits besides the exact one, which has `rows`.

    A quantity that the data do not determine has no value by any method.
    """
    undetermined = {row.quantity for row in rows if not row.determined}
    return tuple(
        plain_row(name, estimate, run, method)
        for method, fit in fits.items()
        if method != FitMethod.EXACT
        for name, estimate in fit.estimates().items()
        if name not in undetermined
    )


def series_rows(
    combined: Mapping[str, CombinedValue],
    budget: Mapping[str, Budget],
    pendulum: PendulumOnBall,
    run_rows: Mapping[str, Sequence[ResultRow]] = MappingProxyType({}),
) -> tuple[ResultRow, ...]:
    """The rows of several runs together, each with the interval of the mean.

    `run_rows` are the runs' rows by parameter. A parameter whose chi2 is no parabola in one of the runs has
    no mean; its limits are combined from those of all runs.
    """
    parameters, nonparabolic = [], set[str]()
    for name, mean in combined.items():
        parameter = law_parameters()[name]
        half = mean.expanded_uncertainty_95
        lower, upper = mean.value - half, mean.value + half
        is_limited = mean.standard_uncertainty > WELL_DETERMINED * abs(mean.value)
        rows = run_rows.get(name, ())
        runs = [_limits(row, run) for row, run in zip(rows, mean.runs, strict=False)]
        # limits of a determined parameter are those of a parabola, with the apparatus
        if any(_is_nonparabolic(*run) for row, run in zip(rows, runs, strict=False) if not row.determined):
            nonparabolic |= {name, *(ENERGIES if name == "c" else ())}
            logarithmic = parameter.logarithmic and all(run.value > 0 for run, _ in runs)
            lower, upper = combined_limits(runs, logarithmic=logarithmic)
            is_limited = True
        verdict = Determinacy.DETERMINED
        if is_limited:
            # the law, and not the data, sets a limit beyond the law's range
            lower = lower if lower > parameter.lower else nan
            upper = upper if upper < parameter.upper else nan
            verdict = _verdict(lower, upper)
        if verdict is Determinacy.UPPER_BOUND and parameter.lower == 0:
            lower = 0.0
        determination = Determination(name, verdict, lower, upper, name in nonparabolic)
        parameters.append((mean.estimate, determination))
    # limits of the runs contain the apparatus already
    remaining = {name: lines for name, lines in budget.items() if name not in nonparabolic}
    return _with_apparatus("series", parameters, remaining, pendulum)


def _verdict(lower: float, upper: float) -> Determinacy:
    """Verdict of limits, either of which may be NaN."""
    if isnan(upper):
        return Determinacy.UNDETERMINED if isnan(lower) else Determinacy.LOWER_BOUND
    return Determinacy.UPPER_BOUND if isnan(lower) else Determinacy.INTERVAL


def _limits(row: ResultRow, run: Estimate) -> tuple[Estimate, tuple[float, float]]:
    """Value and 95 % limits of one run; a lower limit that physics sets is replaced by that of the value."""
    if not (row.verdict is Determinacy.UPPER_BOUND and row.lower == 0):
        return run, (row.lower, row.upper)
    # the profile of a negative value begins at zero; far above zero the data set no lower limit
    run, half = replace(run, value=max(run.value, 0.0)), _NORMAL_95 * run.standard_uncertainty
    return run, (run.value - half if run.value <= half else nan, row.upper)


def _is_nonparabolic(run: Estimate, limits: tuple[float, float]) -> bool:
    """Whether a run's limits differ from those of its value and standard uncertainty."""
    half = _NORMAL_95 * run.standard_uncertainty
    shifts = (limits[0] - (run.value - half), limits[1] - (run.value + half))
    return not all(abs(shift) <= _MAX_NONPARABOLIC_SHIFT * half for shift in shifts)


def _with_apparatus(
    run: str,
    parameters: list[tuple[Estimate, Determination]],
    budget: Mapping[str, Budget],
    pendulum: PendulumOnBall,
) -> tuple[ResultRow, ...]:
    """The rows of parameters with the apparatus, of surface energies, and of the apparatus alone."""
    quantities = {determination.name: (estimate, determination) for estimate, determination in parameters}
    if "c" in quantities:
        estimate, c = quantities["c"]
        # each surface energy is c times a factor of the apparatus
        per_c = surface_energy(Estimate(1.0, 0.0), pendulum)
        for name, factor in zip(ENERGIES, (per_c.table2.value, per_c.eq2.value), strict=True):
            lower, upper = factor * c.lower_95, factor * c.upper_95
            energy = Estimate(*(factor * number for number in estimate))
            quantities[name] = (energy, c._replace(name=name, lower_95=lower, upper_95=upper))
    for name, lines in budget.items():
        exact = Determination(name, Determinacy.DETERMINED, lines.value, lines.value)
        quantities.setdefault(name, (Estimate(lines.value, 0.0), exact))
    rows = []
    for name, (estimate, determination) in quantities.items():
        lower, upper, u_apparatus = determination.lower_95, determination.upper_95, 0.0
        if name in budget and (u_apparatus := budget[name].apparatus_u) > 0:
            expanded = budget[name].coverage_factor_95 * u_apparatus
            lower, upper = _wider_interval(name, estimate.value, (lower, upper), expanded)
        row = ResultRow(
            quantity=name, lower=lower, upper=upper, verdict=determination.verdict, unit=unit_of(name),
            run=run, by_profile=determination.profile_likelihood,
        )  # fmt: skip
        if row.determined:
            value, u = estimate
            row = replace(row, value=value, u=u, u_total=hypot(u, u_apparatus))
        rows.append(row)
    return tuple(rows)


def _wider_interval(
    name: str, value: float, ends: tuple[float, float], expanded: float
) -> tuple[float, float]:
    """The ends of an interval with the apparatus's `expanded` uncertainty added to both sides."""
    parameter = law_parameters().get(name)
    logarithmic = parameter is not None and parameter.logarithmic and ends[0] > 0
    relative = expanded / value if value > 0 else inf
    if logarithmic and relative < _MAX_LOGARITHMIC_U:
        # the unit contains an exponent, so that the interval is symmetric in the logarithm
        low, high = (_wider(width, relative) for width in (log(value / ends[0]), log(ends[1] / value)))
        return value * exp(-low), value * exp(high)
    lower, upper = value - _wider(value - ends[0], expanded), value + _wider(ends[1] - value, expanded)
    # 0 is a limit by physics, which no apparatus moves
    return 0.0 if ends[0] == 0 or (logarithmic and lower < 0) else lower, upper


def _wider(width: float, expanded: float) -> float:
    return hypot(max(width, 0.0), expanded) if isfinite(width) else width


def withheld(budget: Mapping[str, Budget], rows: Sequence[ResultRow]) -> dict[str, Budget]:
    """The budgets; those of undetermined quantities have only the shares of the sources."""
    undetermined = {row.quantity for row in rows if not row.determined}
    return {name: lines.shares_only() if name in undetermined else lines for name, lines in budget.items()}


class RowsByName:
    """Results with a table, whose rows are read by name: ``results["b"]``, ``results["T0"]``."""

    __slots__ = ()

    @property
    def table(self) -> Sequence[ResultRow]:
        """The rows in their order."""
        raise NotImplementedError

    @property
    def rows(self) -> Mapping[str, ResultRow]:
        """The rows by quantity; of a quantity in several rows the first."""
        rows = dict[str, ResultRow]()
        for row in self.table:
            rows.setdefault(row.quantity, row)
        return rows

    @property
    def contact(self) -> Sequence[ResultRow]:
        """The rows of the exact fit and of quantities by it; none where no law was fitted."""
        return [row for row in self.table if row.fit == FitMethod.EXACT]

    def number(self, name: str) -> Estimate:
        """Value and whole uncertainty of a quantity; NaN where there is no such row."""
        row = self.rows.get(name)
        return NOT_DETERMINED if row is None else Estimate(*row)

    def __getitem__(self, name: str) -> ResultRow:
        row = self.rows.get(_SHORT_NAMES.get(name, name))
        if row is None:
            names = ", ".join(self.rows) or "none, since nothing was fitted"
            raise ConfigurationError(f"{name!r}: no such result; there are {names}")
        return row

    def _summary(self, heading: str) -> str:
        """A heading, then one line for each row."""
        return "\n".join([heading, *(f"  {row}" for row in self.contact or self.table)])
