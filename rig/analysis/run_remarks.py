"""Remarks on the results of a run, the same on the terminal and in reports."""

from collections.abc import Iterator, Mapping, Sequence
from enum import StrEnum
from math import inf, isfinite, pi
from typing import Final, NamedTuple

from processing.contact import DRAG
from processing.contact.laws import DEFAULT_LAW
from processing.estimate import Determinacy, Estimate
from processing.fit import WAVEFORM, Budget, Drag, DragFinding, FitMethod, Ground, Response, SeismometerUse
from rig.analysis.decay_values import DECAY
from rig.analysis.result_rows import ENERGIES, SURFACE_ENERGY, ResultRow, named
from rig.analysis.results import RunResults, Series
from rig.terminal import SOURCES, percent, plain, quantity, signed_percent, with_uncertainty

_MIN_NAMED_VARIANCE_SHARE = 0.25
"""Share of the variance above which a source is named; the largest one always is."""


class Limit(NamedTuple):
    """A source of a result's uncertainty, and its share of the variance."""

    source: str
    share: float

    @property
    def name(self) -> str:
        """Name of the source in words."""
        return SOURCES.get(self.source, self.source)

    def __str__(self) -> str:
        return f"{self.name} {100 * self.share:.0f} %"


def limits_of(item: Budget | None) -> list[Limit]:
    """The sources of a budget, the largest first; none where no source of the apparatus (type B) counts."""
    if item is None or not any(line.type == "B" and line.share > 0 for line in item.sources):
        return []
    return [Limit(line.source, line.share) for line in sorted(item.sources, key=lambda line: -line.share)]


def main_sources(row: ResultRow, budget: Mapping[str, Budget]) -> str:
    """The sources of most of a row's variance, largest first: `E of the flat 71 %, half-cycles 26 %`.

    The text is empty for a row that is not determined, or without contributions of the apparatus.
    """
    limits = limits_of(budget.get(row.quantity)) if row.determined else []
    large = [limit for limit in limits if limit.share >= _MIN_NAMED_VARIANCE_SHARE]
    return ", ".join(map(str, large or limits[:1]))


_MIN_SHOWN_SHARE = 0.02
"""Share of the variance below which a source is not among the limits of the main result."""
_REMEDIES: Final[Mapping[str, str]] = {
    "swings": "measure longer, or make more runs",
    "ground": "measure while the ground is quieter, or record it beside the run (rig fit --seismometer)",
    "discrepancy": "see in the report where the law misses the decay, and compare laws (rig fit --law all)",
    "position_errors": "correct the sensor's errors of position",
    "rest_position": "let the pendulum stand where it will swing before the release",
    "friction_step": "fit the parts of the decay on their own, or make more runs",
    "ageing": "wait until the contact has settled, or state its history",
    "adhesion_ageing": "wait until the contact has settled, or state its history",
    "drag_drift": "let the air and its temperature settle, or measure in vacuum",
    "plane_of_swing_rad": "let the pendulum settle before the release, and calibrate the axes",
    "period_drift": "let the temperature settle before the next run",
}


class MainResult(NamedTuple):
    """The main result of a run as text, and its sources of uncertainty; empty where nothing was fitted."""

    text: str = ""
    uncertainty: str = ""
    """Words on what the uncertainty covers: the whole budget, or the half-cycles alone."""
    limits: Sequence[Limit] = ()
    """Sources of the uncertainty, the largest first."""
    symbol: str = ""
    """Symbol of the quantity; empty if none is determined."""
    ground_seen: bool = True
    """Whether the run shows a drive of the ground; else it only sets a bound."""

    @property
    def next_steps(self) -> list[str]:
        """A remedy for each source of much of the uncertainty."""
        large = [limit for limit in self.limits if limit.share >= _MIN_NAMED_VARIANCE_SHARE]
        # a drive of the ground that is not seen has a bound, which more half-cycles lower
        remedies = _REMEDIES if self.ground_seen else {**_REMEDIES, "ground": _REMEDIES["swings"]}
        steps = [remedies.get(limit.source, f"determine {limit.name} more accurately") for limit in large]
        return list(dict.fromkeys(steps))


def main_result(run: RunResults, series: Series | None = None) -> MainResult:
    """The main result: the surface energy, else the first parameter of the law that the data determine.

    The rows are those of a `series` if it has a table, else of the run.
    """
    if run.instrument is not None:
        return MainResult(run.instrument.text[0] if run.instrument.text else "", "the swings")
    source = series if series is not None and series.table else run
    if not source.contact:
        return MainResult()
    rows = source.rows
    names = (name for name in (SURFACE_ENERGY, *DEFAULT_LAW.names(drag=False)) if name in rows)
    row = next((rows[name] for name in names if rows[name].determined), None)
    if row is None:
        return MainResult("No parameter is determined", "", [Limit("swings", 1.0)])
    limits = limits_of(source.budget.get(row.quantity))
    symbol = quantity(row.quantity).symbol
    text = row.equation.replace(symbol, named(row.quantity).partition(" / ")[0], 1)
    if not limits:
        return MainResult(text, "the swings alone", [Limit("swings", 1.0)], symbol)
    limits = [limit for limit in limits if limit.share >= _MIN_SHOWN_SHARE]
    exact = run.fits.get(FitMethod.EXACT)
    ground_seen = exact is None or exact.ground is None or exact.ground.seen
    return MainResult(text, "the whole budget, swings and apparatus", limits, symbol, ground_seen)


_FINDINGS = {
    DragFinding.SEEN: "The decay shows a linear drag",
    DragFinding.NEGATIVE: "A negative drag fits best, so something is missing from the model",
    DragFinding.UNSEEN: "No linear drag is seen",
    DragFinding.OPEN: "This decay cannot distinguish a drag from friction",
}
_MIN_NAMED_FACTOR = 1.5
"""Factor on an uncertainty, by the ground or without the waveform, above which it is named."""


class RemarkLevel(StrEnum):
    """Level of a remark, which decides where it is shown."""

    RESULT = "result"
    """A remark for every reader of the numbers: on a drag, the ground, an auxiliary seismometer."""
    ADVICE = "advice"
    """The main source of the result's uncertainty, and remedies."""
    DETAIL = "detail"
    """A detail for the report and for `rig -v`."""
    CONDITION = "condition"
    """A condition of the run that was not met, or is doubtful."""
    WARNING = "warning"
    """A warning of the fits or of the record."""
    OTHER_FIT = "of another fit"
    """A warning of the asymptotic fit alone: it concerns no number of the exact one."""


class Remark(NamedTuple):
    """A row of the table of remarks."""

    code: str
    """The subject."""
    level: RemarkLevel
    text: str
    remedy: str = ""

    @property
    def line(self) -> str:
        """Text and remedy in one line."""
        return f"{self.text}; {self.remedy}" if self.level is RemarkLevel.CONDITION else self.text


def remark_rows(run: RunResults, *levels: RemarkLevel) -> list[Remark]:
    """The table of remarks of a run in the order of reading; of the stated `levels`, by default of all."""
    rows = [row for row in _remarks(run) if row.text]
    return [row for row in rows if not levels or row.level in levels]


def remarks(run: RunResults) -> list[str]:
    """Sentences on beam, ground, drag and undetermined quantities, then the run's notes."""
    return [row.text for row in remark_rows(run, RemarkLevel.RESULT, RemarkLevel.DETAIL)]


def _remarks(run: RunResults) -> Iterator[Remark]:
    exact, result, detail = run.fits.get(FitMethod.EXACT), RemarkLevel.RESULT, RemarkLevel.DETAIL
    parameters = {} if exact is None else exact.parameters
    is_fitted, ground = DRAG.key in parameters, None if exact is None else exact.ground
    if parameters and not is_fitted:
        in_vacuum = "Fitted without a drag, as in vacuum: if there was air, its drag is in b and c."
        yield Remark("drag", result, in_vacuum)
    if run.beam is not None:
        yield Remark("beam", detail, run.beam.sentence)
    if run.clock is not None:
        yield Remark("clock", detail, f"Camera's clock: {run.clock.text}.")
    if ground is not None:
        yield Remark("ground", result if ground.seen else detail, ground_sentence(ground))
    for line in () if run.seismometer is None else seismometer_sentences(run.seismometer):
        yield Remark("seismometer", result, line)
    if run.drag is not None:
        sentence = _drag_sentence(run.drag, run.rows, fitted=is_fitted)
        yield Remark("drag", result if run.drag.significant else detail, sentence)
    if exact is not None:
        yield Remark("waveform", detail, _waveform_sentence(exact.information_gain))
        yield Remark("advice", RemarkLevel.ADVICE, _advice(main_result(run)))
    for row in run.contact:
        if not row.determined and row.quantity not in ENERGIES:
            text = f"Not determined: {row.shown.symbol}, {row.text} {row.shown.unit}".rstrip()
            yield Remark("not determined", detail, f"{text}.")
    for note in run.notes:
        yield Remark("note", detail, note)
    for verdict in run.conditions:
        if not verdict.ok or verdict.remedy:
            text = f"{verdict.name.upper()}: {verdict.finding}"
            yield Remark(verdict.name, RemarkLevel.CONDITION, text, verdict.remedy)
    for warning in run.warnings:
        is_other_fit = warning.startswith(f"{FitMethod.ASYMPTOTIC} fit: ")
        yield Remark("warning", RemarkLevel.OTHER_FIT if is_other_fit else RemarkLevel.WARNING, warning)


def _advice(result: MainResult) -> str:
    """Sentence on the main limit of a result and its remedies; empty where nothing was fitted."""
    steps = "; ".join(result.next_steps)
    if not steps:
        return ""
    if result.symbol:
        return f"{result.symbol} is limited by: {result.limits[0].name}. To improve it: {steps}."
    return f"{result.text}. To improve it: {steps}."


def ground_sentence(ground: Ground) -> str:
    """Sentence on the drive of the ground: a value, or a bound where the run shows none."""
    count = ground.left_out_half_cycles
    left_out = f"; the last {count} half-cycles are its motion and were not fitted" if count else ""
    drive = drive_text(ground.density_rad_per_s2_rthz, ground.upper_95, "rad", seen=ground.seen)
    sentence = f"Ground at the pendulum's frequency: {drive}{left_out}."
    factors = _factors_text(ground.widening, _MIN_NAMED_FACTOR, 2)
    if not factors or not ground.seen:
        return sentence
    return (
        f"{sentence} It enlarges the uncertainties by factors of {factors}. "
        "Finer balancing, a quieter hour, a larger first amplitude or more runs would help."
    )


def drive_text(density: Estimate, upper_95: float, unit: str, *, seen: bool) -> str:
    """A drive as text; `unit` is that of the deflections."""
    unit = f"{unit}/s²/√Hz"
    return f"{with_uncertainty(*density)} {unit}" if seen else f"below {plain(upper_95, 2)} {unit} (95 %)"


def _factors_text(factors: Mapping[str, float], min_factor: float, digits: int) -> str:
    """Finite factors above `min_factor` with the symbols of their quantities, the largest first."""
    large = sorted(factors.items(), key=lambda item: -item[1])
    return ", ".join(
        f"{plain(factor, digits)} ({quantity(name).symbol})"
        for name, factor in large
        if min_factor < factor and isfinite(factor)
    )


CLOCK_SET = "clock set while it was recorded,"
"""Beginning of a line on how a seismometer was read."""
_MIN_NAMED_SAVING = 1.05
"""Factor by which a seismometer reduces an uncertainty, above which it is named."""


def seismometer_sentences(use: SeismometerUse) -> list[str]:
    """Sentences on the use of a seismometer, or its refusal, and on samples that were left out."""
    lost = [line for line in use.understood if line.startswith(("left out", "missing", CLOCK_SET))]
    return [*_use_sentences(use), *([f"Of the seismometer {use.source}: {'; '.join(lost)}."] if lost else [])]


def _use_sentences(use: SeismometerUse) -> list[str]:
    if not use.used:
        gain = use.gain_of_prediction
        gain_text = f" (gain of prediction {gain:+.3g})" if isfinite(gain) else ""
        reason = f": {use.reason}" if use.reason else ""
        refused = f"Auxiliary seismometer {use.verdict}{reason}{gain_text}."
        same = "The results are the same as without it."
        offset = "If its clock is off by more than a second, --seismometer-offset states by how much."
        return [f"{refused} {same} {offset}"]
    explained = (
        f"it explains {percent(use.explained, 4)} of the drive at the pendulum's frequency, which falls from "
        f"{with_uncertainty(*use.ground_alone_rad_per_s2_rthz)} to "
        f"{with_uncertainty(*use.ground_left_rad_per_s2_rthz)} rad/s²/√Hz"
    )
    responses = "; ".join(map(_response_text, use.responses))
    sentences = [f"Auxiliary seismometer: {explained}. Its response: {responses}."]
    if savings := _factors_text(use.saved, _MIN_NAMED_SAVING, 3):
        sentences.append(f"The seismometer reduces the uncertainties by factors of {savings}.")
    sentences.append(
        f"Clock of the seismometer: {with_uncertainty(*use.delay_s)} s to be added to its times, "
        f"drift {with_uncertainty(*use.clock_drift)} s/s."
    )
    if use.missing_half_cycles:
        sentences.append(
            f"{use.missing_half_cycles} half-swings have no seismometer's record; their drive is treated as "
            "unknown."
        )
    return sentences


def _response_text(response: Response) -> str:
    degrees = 180 / pi
    slope = ", changing within the band" if response.with_slope else ""
    return (
        f"{response.name} {with_uncertainty(response.gain, response.u_gain)} rad/s² per unit at "
        f"{with_uncertainty(degrees * response.phase_rad, degrees * response.u_phase_rad)}°{slope}"
    )


def _waveform_sentence(information_gain: Mapping[str, Mapping[str, float]]) -> str:
    """Sentence on the information gain by the waveform; empty where it is small."""
    gains = information_gain.get(WAVEFORM, {})
    factors = _factors_text(gains, _MIN_NAMED_FACTOR, 2)
    effects = [f"the uncertainties would be larger, by factors of {factors}"] if factors else []
    lost = " and ".join(quantity(name).symbol for name, factor in gains.items() if factor == inf)
    effects += [f"{lost} would not be determined at all"] if lost else []
    return f"Without the waveform of the swing {', and '.join(effects)}." if effects else ""


def _drag_sentence(drag: Drag, rows: Mapping[str, ResultRow], *, fitted: bool) -> str:
    """Sentence on the drag (`fitted` if a parameter of the fit) by the data, or on the prior in use."""
    shown, row = quantity("drag_s"), rows.get("drag_s")
    shifts = {"b": drag.relative_shift_b, "c": drag.relative_shift_c}
    changes = " and ".join(
        f"{name} by {signed_percent(shift)}"
        for name, shift in shifts.items()
        if name not in rows or rows[name].determined
    )
    moved = f"; it changes {changes}" if changes else ""
    u_s = drag.of_data_s.standard_uncertainty
    is_of_data = drag.known_s is None or u_s < drag.known_s.standard_uncertainty
    match drag.finding:
        case DragFinding.SEEN if row is not None and row.verdict is Determinacy.UNDETERMINED:
            return f"{_FINDINGS[drag.finding]}{moved}.".replace("-", "−")
        case DragFinding.SEEN:
            drag_text = f"{shown.text(*drag.drag_s) if row is None else row.text} s{moved}"
        case DragFinding.OPEN if is_of_data and isfinite(drag.upper_95_s):
            place = "part of every uncertainty" if fitted else "in no uncertainty (fit.drag = vacuum)"
            return (
                f"This decay cannot distinguish a drag below {plain(drag.upper_95_s, 2)} s (95 %) from "
                f"friction; what it allows, {shown.text(*drag.of_data_s)} s, is {place}{moved}."
            ).replace("-", "−")
        case DragFinding.OPEN if drag.known_s is not None:
            drag_text = (
                f"the drag expected of the air, {shown.text(*drag.known_s)} s, is used; its uncertainty is "
                f"part of all others{moved}"
            )
        case DragFinding.OPEN:
            known = f"{shown.text(*drag.drag_s)} s; " if isfinite(drag.drag_s.value) else ""
            drag_text = f"{known}state what you know of the air (fit.drag)"
        case _:
            drag_text = (
                f"{shown.text(*drag.of_data_s)} s, with a probability of {plain(drag.p_value, 2)} by chance"
            )
    return f"{_FINDINGS[drag.finding]}: {drag_text}.".replace("-", "−")


def decay_lines(results: RunResults) -> list[str]:
    """Lines on period, decrement, quality factor and damping of a decay, as far as they are known."""
    names = {"mean_period_s": "period", "log_decrement": "", "quality_factor": ""}
    lines = [
        f"{names[row.quantity] or row.shown.symbol} {row.text} {row.shown.unit}".rstrip()
        for row in results.table
        if row.fit == DECAY and row.quantity in names
    ]
    if results.damping is not None:
        lines += results.damping.lines(results.amplitude_unit or "")
    return lines
