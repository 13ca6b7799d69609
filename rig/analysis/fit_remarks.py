"""What is said about a run's fits beyond their numbers, the same on the terminal and in reports."""

from collections.abc import Mapping
from math import isfinite

from processing.contact import DRAG
from processing.estimate import Determinacy, Estimate
from processing.fit import WAVEFORM, BaseMotion, Drag, DragFinding, FitMethod, Ground
from rig.analysis.headline import drag_headline, headline, shifts_by_drag, whole_result
from rig.analysis.result_rows import ENERGIES, ResultRow
from rig.analysis.results import RunResults
from rig.analysis.witnessed_fits import witness_sentences
from rig.presentation import plain, quantity, with_uncertainty

_FOUND = {
    DragFinding.SEEN: "The decay shows a linear drag",
    DragFinding.NEGATIVE: "A negative drag fits best, so something is missing from the model",
    DragFinding.UNSEEN: "No linear drag is seen",
    DragFinding.OPEN: "This decay cannot distinguish a drag from friction",
}
_MUCH = 1.5
"""Factor by which the ground enlarges an uncertainty, from which on it is named."""


def remarks(run: RunResults) -> list[str]:
    """The headline, sentences on beam, ground, drag and what is hardly determined, then the run's notes."""
    exact = run.fits.get(FitMethod.EXACT)
    parameters = {} if exact is None else exact.parameters
    of_drag = drag_headline(run.drag, run.rows, fitted=DRAG.key in parameters) if parameters else ""
    lines = list(filter(None, [headline(run.rows, run.budget), of_drag]))
    lines += [] if run.beam is None else [run.beam.sentence]
    lines += [] if run.clock is None else [f"Camera's clock: {run.clock.text}."]
    lines += [ground_sentence(exact.ground)] if exact is not None and exact.ground is not None else []
    lines += [] if run.witness is None else witness_sentences(run.witness)
    row = run.rows.get(DRAG.key)
    is_withheld = row is not None and row.verdict is Determinacy.UNDETERMINED
    if run.drag is not None and not (run.drag.significant and is_withheld):
        lines.append(_drag_sentence(run.drag, run.rows))
    lines += [] if exact is None else list(filter(None, [_worth_sentence(exact.worth)]))
    if run.strong_correlations:
        pairs = run.strong_correlations
        names = ", ".join(f"{quantity(a).symbol} and {quantity(b).symbol} ({r:+.3f})" for a, b, r in pairs)
        lines.append(f"Strongly correlated in this run: {names}.".replace("-", "−"))
    lines += [
        f"Not determined: {row.shown.symbol}, {row.text} {row.shown.unit}".rstrip() + "."
        for row in run.table
        if not row.determined and row.quantity not in ENERGIES
    ]
    return [*lines, *run.notes]


def brief_remarks(run: RunResults) -> list[str]:
    """What no reader of the result should miss: a drag, a ground that is seen, a witness, what to do next."""
    exact = run.fits.get(FitMethod.EXACT)
    if exact is None:
        return []
    lines = [drag_headline(run.drag, run.rows, fitted=DRAG.key in exact.parameters)]
    lines += [ground_sentence(exact.ground)] if exact.ground is not None and exact.ground.seen else []
    lines += [] if run.witness is None else witness_sentences(run.witness)
    result = whole_result(run)
    steps = "; ".join(result.next_steps)
    if steps and result.symbol:
        lines.append(f"{result.symbol} is limited by: {result.limits[0].name}. To improve it: {steps}.")
    elif steps:
        lines.append(f"{result.text}. To improve it: {steps}.")
    return list(filter(None, lines))


def ground_sentence(ground: Ground) -> str:
    """How strongly the ground drove the pendulum: a value, or a bound where the run shows none."""
    left_out = (
        f"; the last {ground.left_out_half_cycles} half-cycles are its motion and were not fitted"
        if ground.left_out_half_cycles
        else ""
    )
    drive = drive_text(ground.density_rad_per_s2_rthz, ground.upper_95, ground.base, seen=ground.seen)
    return f"Ground at the pendulum's frequency: {drive}{left_out}.{_cost(ground)}"


def drive_text(
    density: Estimate, upper_95: float, base: BaseMotion | None, *, seen: bool, unit: str = "rad"
) -> str:
    """A drive, and the motion of the ground where the mass centre's height says what that is."""
    text = _density(density, upper_95, f"{unit}/s²/√Hz", seen)
    if base is None:
        return text
    nano = Estimate(*(1e9 * number for number in base.acceleration_m_per_s2_rthz))
    text += ", " + _density(nano, 1e9 * base.upper_95, "nm/s²/√Hz", seen)
    text += f" of acceleration for a mass centre {plain(1e3 * base.mass_centre_height_m, 3)} mm high"
    return text + (f", NLNM {base.above_low_noise_model_db:+.0f} dB" if seen else "")


def _density(found: Estimate, upper_95: float, unit: str, seen: bool) -> str:
    return f"{with_uncertainty(*found)} {unit}" if seen else f"below {plain(upper_95, 2)} {unit} (95 %)"


def _cost(ground: Ground) -> str:
    """What the ground adds to the uncertainties, and what would help; nothing where it adds little."""
    widened = {name: factor for name, factor in ground.widening.items() if factor > _MUCH}
    if not widened or not ground.seen:
        return ""
    listed = ", ".join(
        f"{plain(factor, 2)} ({quantity(name).symbol})"
        for name, factor in sorted(widened.items(), key=lambda item: -item[1])
    )
    return (
        f" It enlarges the uncertainties by factors of {listed}. "
        "Finer balancing, a quieter hour, a larger first amplitude or more runs would help."
    )


def _worth_sentence(worth: Mapping[str, Mapping[str, float]]) -> str:
    """What the waveform gave, where that is much."""
    gained = {name: one for name, one in worth.get(WAVEFORM, {}).items() if one > _MUCH}
    if not gained:
        return ""
    ordered = sorted(gained.items(), key=lambda item: -item[1])
    listed = ", ".join(f"{plain(one, 2)} ({quantity(name).symbol})" for name, one in ordered if isfinite(one))
    said = [f"the uncertainties would be larger, by factors of {listed}"] if listed else []
    lost = " and ".join(quantity(name).symbol for name, one in ordered if not isfinite(one))
    said += [f"{lost} would not be determined at all"] if lost else []
    return f"Without the waveform of the swing {', and '.join(said)}."


def _drag_sentence(drag: Drag, rows: Mapping[str, ResultRow]) -> str:
    """What the data say of a drag, and whose value stands where they say nothing."""
    shown, shifts, row = quantity("drag_s"), shifts_by_drag(drag, rows), rows.get("drag_s")
    changes = " and ".join(f"{name} by {shift}" for name, shift in shifts.items())
    moved = f"; it changes {changes}" if changes else ""
    match drag.finding:
        case DragFinding.SEEN:
            said = f"{shown.text(*drag.drag_s) if row is None else row.text} s{moved}"
        case DragFinding.OPEN if _by_the_data(drag):
            return (
                f"This decay cannot distinguish a drag below {plain(drag.upper_95_s, 2)} s (95 %) from "
                f"friction; what it allows, {shown.text(*drag.of_data_s)} s, is part of every uncertainty"
                f"{moved}."
            ).replace("-", "−")
        case DragFinding.OPEN if drag.known_s is not None:
            said = (
                f"the drag expected of the air, {shown.text(*drag.known_s)} s, is used; its uncertainty is "
                f"part of all others{moved}"
            )
        case DragFinding.OPEN:
            said = f"{shown.text(*drag.drag_s)} s; state what you know of the air (fit.drag)"
        case _:
            said = (
                f"{shown.text(*drag.of_data_s)} s, with a probability of {plain(drag.p_value, 2)} by chance"
            )
    return f"{_FOUND[drag.finding]}: {said}.".replace("-", "−")


def _by_the_data(drag: Drag) -> bool:
    """Whether the data know the drag better than what is known of the air."""
    u_s = drag.of_data_s.standard_uncertainty
    return isfinite(drag.upper_95_s) and (drag.known_s is None or u_s < drag.known_s.standard_uncertainty)
