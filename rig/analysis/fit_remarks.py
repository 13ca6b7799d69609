"""What is said about a run's fits beyond their numbers, the same on the terminal and in reports."""

from processing.fit import FitMethod
from rig.analysis.contact_results import Drag, Ground
from rig.analysis.results import RunResults
from rig.presentation import plain, quantity, with_uncertainty


def remarks(run: RunResults) -> list[str]:
    """Sentences on the ground, drag, correlated and undetermined parameters, then the run's notes."""
    exact = run.fits.get(FitMethod.EXACT)
    lines = [ground_sentence(exact.ground)] if exact is not None and exact.ground is not None else []
    lines += [_drag_sentence(run.drag)] if run.drag is not None else []
    if run.strong_correlations:
        pairs = run.strong_correlations
        names = ", ".join(f"{quantity(a).symbol} and {quantity(b).symbol} ({r:+.3f})" for a, b, r in pairs)
        lines.append(f"Hardly told apart by the data (correlation): {names}.".replace("-", "−"))
    lines += [f"{item.text}." for item in run.identifiability if item.verdict != "determined"]
    return [*lines, *run.notes]


def ground_sentence(ground: Ground) -> str:
    """How strongly the ground drove the pendulum: a value, or a bound where the run shows none."""
    density = (
        with_uncertainty(*ground.density_rad_per_s2_rthz)
        if ground.seen
        else f"below {plain(ground.upper_95, 2)} (95 %)"
    )
    left_out = (
        f"; the last {ground.left_out_half_cycles} half-cycles are its motion and were not fitted"
        if ground.left_out_half_cycles
        else ""
    )
    return f"Ground at the pendulum's frequency: {density} rad/s²/√Hz{left_out}."


def _drag_sentence(drag: Drag) -> str:
    head = "A linear drag is in the data" if drag.significant else drag.text.split(":")[0].capitalize()
    numbers = (
        f"{head}: {quantity('drag_s').text(*drag.drag_s)} s, F = {plain(drag.f_statistic, 3)} (chance "
        f"{plain(drag.p_value, 2)}), AIC {drag.aic_difference:+.1f}; fitted with it, b moves by "
        f"{100 * drag.relative_shift_b:+.2f} % and c by {100 * drag.relative_shift_c:+.2f} %."
    )
    return numbers.replace("-", "−")
