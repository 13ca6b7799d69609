"""The table of results: one row for every quantity, made once, and read by every output."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from math import exp, floor, hypot, inf, isfinite, isnan, log, log10, nan
from types import MappingProxyType
from typing import Annotated, Any, Final

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
"""Relative uncertainty by the apparatus up to which it is added in the logarithm of a parameter: near zero it
could be any number."""
_NORMAL_95: Final = 1.959964
_MAX_BEND: Final = 0.25
"""Largest difference of a run's limits from those of a parabola, over their half-width, at which runs have a
mean: Student's t of ten half-cycles makes a sixth."""
_QUANTITY_UNIT = Quantity("", "", unit=OF + "quantity")


@dataclass(frozen=True, slots=True, kw_only=True, repr=False)
class ResultRow:
    """One quantity of a run or a series.

    `fit` names the source: the exact fit, the decay alone, a theory of adhesion.

    `value`, `u` and `u_total` are NaN unless the data determine the quantity; `lower` and `upper` are then
    all that is known. `u` is the standard uncertainty of the half-cycles alone, `u_total` that of half-cycles
    and apparatus together, `lower` to `upper` the 95 % interval, of both together; a limit that the data do
    not set is NaN. `unit` is that of the numbers. `by_profile` is whether the interval is by the profile
    likelihood, else it is by the covariance. `run` is the run's name, "series" for several together.

    It unpacks: ``value, u_total = row``.
    """

    quantity: str
    fit: str = FitMethod.EXACT.value
    value: Annotated[float, _QUANTITY_UNIT] = nan
    u: Annotated[float, _QUANTITY_UNIT] = nan
    u_total: Annotated[float, _QUANTITY_UNIT] = nan
    lower: Annotated[float, _QUANTITY_UNIT] = nan
    upper: Annotated[float, _QUANTITY_UNIT] = nan
    verdict: Determinacy = Determinacy.DETERMINED
    unit: str = ""
    run: str = ""
    by_profile: bool = False

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
        """``b = (3.73 ± 0.02) × 10⁻³ rad⁻ᵖ``, ``c < 1.4 × 10⁻⁸ (95 %)``."""
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
    name: str,
    found: Estimate | float,
    run: str,
    fit: str = FitMethod.EXACT.value,
    unit: str = "",
    **known: Any,
) -> ResultRow:
    """The row of a number, or of a value with its standard uncertainty; `known` are further numbers of it."""
    value, u = found if isinstance(found, Estimate) else (found, nan)
    return ResultRow(
        quantity=name, fit=fit, value=value, u=u, u_total=u, unit=unit or unit_of(name), run=run, **known
    )


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
    known = {one.name: one for one in determinations}
    found = []
    for name in fit.contact_names:
        estimate, verdict = fit.estimate(name), Determinacy.UNDETERMINED
        if estimate.standard_uncertainty <= WELL_DETERMINED * abs(estimate.value):
            verdict = Determinacy.DETERMINED
        ends = fit.interval(name) if verdict is Determinacy.DETERMINED else (nan, nan)
        found.append((estimate, known.get(name) or Determination(name, verdict, *ends)))
    return _with_apparatus(run, found, budget, pendulum)


def rows_of_others(
    run: str, fits: Mapping[str, FitResult], rows: Sequence[ResultRow]
) -> tuple[ResultRow, ...]:
    """The rows of a run's fits besides the exact one, which has `rows`.

    A quantity that the data do not determine has no value by any method.
    """
    left_open = {row.quantity for row in rows if not row.determined}
    return tuple(
        plain_row(key, found, run, method)
        for method, fit in fits.items()
        if method != FitMethod.EXACT
        for key, found in fit.estimates().items()
        if key not in left_open
    )


def series_rows(
    combined: Mapping[str, CombinedValue],
    budget: Mapping[str, Budget],
    pendulum: PendulumOnBall,
    of_runs: Mapping[str, Sequence[ResultRow]] = MappingProxyType({}),
) -> tuple[ResultRow, ...]:
    """The rows of several runs together, each with the interval of the mean.

    `of_runs` are the rows of the runs: a parameter whose chi2 is no parabola in one of them has no mean, and
    limits by those of all runs.
    """
    found, bent = [], set[str]()
    for name, item in combined.items():
        parameter = law_parameters()[name]
        half = item.expanded_uncertainty_95
        lower, upper = item.value - half, item.value + half
        is_limited = item.standard_uncertainty > WELL_DETERMINED * abs(item.value)
        rows = of_runs.get(name, ())
        runs = [_limits(row, run) for row, run in zip(rows, item.runs, strict=False)]
        # limits of what is determined are those of a parabola, with the apparatus
        if any(_bends(*run) for row, run in zip(rows, runs, strict=False) if not row.determined):
            bent |= {name, *(ENERGIES if name == "c" else ())}
            logarithmic = parameter.logarithmic and all(run.value > 0 for run, _ in runs)
            lower, upper = combined_limits(runs, logarithmic=logarithmic)
            is_limited = True
        verdict = Determinacy.DETERMINED
        if is_limited:
            # beyond the range of the law a limit is none of the data
            lower, upper = (
                lower if lower > parameter.lower else nan,
                upper if upper < parameter.upper else nan,
            )
            verdict = _verdict(lower, upper)
        if verdict is Determinacy.UPPER_BOUND and parameter.lower == 0:
            lower = 0.0
        found.append((item.estimate, Determination(name, verdict, lower, upper, name in bent)))
    # limits of the runs contain the apparatus already
    rest = {name: lines for name, lines in budget.items() if name not in bent}
    return _with_apparatus("series", found, rest, pendulum)


def _verdict(lower: float, upper: float) -> Determinacy:
    """Verdict of limits, either of which may be NaN."""
    if isnan(upper):
        return Determinacy.UNDETERMINED if isnan(lower) else Determinacy.LOWER_BOUND
    return Determinacy.UPPER_BOUND if isnan(lower) else Determinacy.INTERVAL


def _limits(row: ResultRow, run: Estimate) -> tuple[Estimate, tuple[float, float]]:
    """Value and 95 % limits of one run; where only physics sets the lower one, as if it might be negative."""
    if not (row.verdict is Determinacy.UPPER_BOUND and row.lower == 0):
        return run, (row.lower, row.upper)
    # the profile of a negative value begins at zero; far above zero it is the data that set no limit
    run, half = replace(run, value=max(run.value, 0.0)), _NORMAL_95 * run.standard_uncertainty
    return run, (run.value - half if run.value <= half else nan, row.upper)


def _bends(run: Estimate, limits: tuple[float, float]) -> bool:
    """Whether a run's limits are other ones than those of its value and standard uncertainty."""
    half = _NORMAL_95 * run.standard_uncertainty
    return not all(
        abs(end - parabola) <= _MAX_BEND * half
        for end, parabola in zip(limits, (run.value - half, run.value + half), strict=True)
    )


def _with_apparatus(
    run: str,
    found: list[tuple[Estimate, Determination]],
    budget: Mapping[str, Budget],
    pendulum: PendulumOnBall,
) -> tuple[ResultRow, ...]:
    """The rows of what was found, with the apparatus, of surface energies, and of the apparatus alone.

    The apparatus adds to the uncertainty, and to both sides of the interval. A quantity that is not
    determined has neither value nor uncertainty.
    """
    for estimate, c in [each for each in found if each[1].name == "c"]:
        # each surface energy is c times a factor of the apparatus
        per_c = surface_energy(Estimate(1.0, 0.0), pendulum)
        for name, factor in zip(ENERGIES, (per_c.table2.value, per_c.eq2.value), strict=True):
            lower, upper = factor * c.lower_95, factor * c.upper_95
            energy = Estimate(*(factor * number for number in estimate))
            found.append((energy, c._replace(name=name, lower_95=lower, upper_95=upper)))
    names = {one.name for _, one in found}
    found += [
        (Estimate(item.value, 0.0), Determination(name, Determinacy.DETERMINED, item.value, item.value))
        for name, item in budget.items()
        if name not in names
    ]
    rows = []
    for estimate, one in found:
        item, ends = budget.get(one.name), (one.lower_95, one.upper_95)
        part = 0.0 if item is None else item.apparatus_u
        if item is not None and part > 0:
            ends = _wider_ends(one.name, estimate.value, ends, item.coverage_factor_95 * part)
        numbers = (*estimate, hypot(estimate.standard_uncertainty, part))
        value, u, u_total = numbers if one.verdict is Determinacy.DETERMINED else (nan, nan, nan)
        more = dict[str, Any](verdict=one.verdict, by_profile=one.profile_likelihood, run=run)
        more |= {"quantity": one.name, "unit": unit_of(one.name), "lower": ends[0], "upper": ends[1]}
        rows.append(ResultRow(value=value, u=u, u_total=u_total, **more))
    return tuple(rows)


def _wider_ends(name: str, value: float, ends: tuple[float, float], expanded: float) -> tuple[float, float]:
    """The ends of an interval with the apparatus's `expanded` uncertainty added to both sides."""
    parameter = law_parameters().get(name)
    logarithmic = parameter is not None and parameter.logarithmic and ends[0] > 0
    relative = expanded / value if value > 0 else inf
    if logarithmic and relative < _MAX_LOGARITHMIC_U:
        # the unit contains an exponent, so that the interval is symmetric in the logarithm
        low, high = (_wider(side, relative) for side in (log(value / ends[0]), log(ends[1] / value)))
        return value * exp(-low), value * exp(high)
    lower, upper = value - _wider(value - ends[0], expanded), value + _wider(ends[1] - value, expanded)
    # 0 is a limit by physics, which no apparatus moves
    return 0.0 if ends[0] == 0 or (logarithmic and lower < 0) else lower, upper


def _wider(side: float, part: float) -> float:
    return hypot(max(side, 0.0), part) if isfinite(side) else side


def withheld(budget: Mapping[str, Budget], rows: Sequence[ResultRow]) -> dict[str, Budget]:
    """The budgets; those of undetermined quantities have only the shares of the sources."""
    known = {row.quantity: row.determined for row in rows}
    return {name: item if known.get(name, True) else item.shares_only() for name, item in budget.items()}


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
        found = dict[str, ResultRow]()
        for row in self.table:
            found.setdefault(row.quantity, row)
        return found

    @property
    def contact(self) -> Sequence[ResultRow]:
        """The rows of the exact fit and of quantities by it; none where no law was fitted."""
        return [row for row in self.table if row.fit == FitMethod.EXACT]

    def number(self, name: str) -> Estimate:
        """Value and whole uncertainty of a quantity; NaN where there is no such row."""
        row = self.rows.get(name)
        return NOT_DETERMINED if row is None else Estimate(*row)

    def __getitem__(self, name: str) -> ResultRow:
        found = self.rows.get(_SHORT_NAMES.get(name, name))
        if found is None:
            known = ", ".join(self.rows) or "none, since nothing was fitted"
            raise ConfigurationError(f"{name!r}: no such result; there are {known}")
        return found

    def _summary(self, head: str) -> str:
        """A head, then one line for each row."""
        return "\n".join([head, *(f"  {row}" for row in self.contact or self.table)])
