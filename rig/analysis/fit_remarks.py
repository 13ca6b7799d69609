"""What is said about a run's fits beyond their numbers, the same on the terminal and in reports."""

from rig.analysis.contact_results import Drag
from rig.analysis.results import RunResults
from rig.presentation import plain, quantity


def remarks(run: RunResults) -> list[str]:
    """Sentences on drag, correlated and undetermined parameters, then the run's notes."""
    lines = [_drag_sentence(run.drag)] if run.drag is not None else []
    if run.strong_correlations:
        pairs = run.strong_correlations
        names = ", ".join(f"{quantity(a).symbol} and {quantity(b).symbol} ({r:+.3f})" for a, b, r in pairs)
        lines.append(f"Hardly told apart by the data (correlation): {names}.".replace("-", "−"))
    lines += [f"{item.text}." for item in run.identifiability if item.verdict != "determined"]
    return [*lines, *run.notes]


def _drag_sentence(drag: Drag) -> str:
    head = "A linear drag is in the data" if drag.significant else drag.text.split(":")[0].capitalize()
    numbers = (
        f"{head}: {quantity('drag_s').text(*drag.drag_s)} s, F = {plain(drag.f_statistic, 3)} (chance "
        f"{plain(drag.p_value, 2)}), AIC {drag.aic_difference:+.1f}; fitted with it, b moves by "
        f"{100 * drag.relative_shift_b:+.2f} % and c by {100 * drag.relative_shift_c:+.2f} %."
    )
    return numbers.replace("-", "−")
