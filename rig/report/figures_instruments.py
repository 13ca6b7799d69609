"""What users of other pendulums expect: decrement and period against amplitude, the plane that turns."""

import numpy as np

from rig.analysis import DecrementTable, InstrumentResults, PeriodTable, SwingPlane
from rig.report.drawing import DATA, EXACT, INK, SMOOTH, Drawing, canvas


def instrument_figures(values: InstrumentResults) -> list[Drawing]:
    """Figures of what a run reports; those whose numbers are there."""
    drawings = []
    if values.decrement_against_amplitude is not None:
        drawings.append(_decrement(values.decrement_against_amplitude))
    if values.table is not None:
        drawings.append(_period(values.table))
    if values.swing_plane is not None:
        drawings.append(_plane(values.swing_plane))
    return drawings


def _decrement(table: DecrementTable) -> Drawing:
    figure = canvas(2.8)
    axes = figure.subplots()
    figure.subplots_adjust(left=0.12, right=0.97, bottom=0.17, top=0.95)
    axes.errorbar(
        table.amplitude_deg,
        table.log_decrement,
        yerr=table.u_log_decrement,
        fmt="o",
        color=DATA,
        ecolor=INK,
        elinewidth=0.6,
    )
    axes.set_xscale("log")
    axes.set_xlabel("amplitude / degrees")
    axes.set_ylabel("log decrement of a whole swing")
    return Drawing(
        "kind-decrement",
        "Log decrement against amplitude",
        "Decrement of a whole swing, from turning points some swings apart; bars: one standard uncertainty.",
        figure,
    )


def _period(table: PeriodTable) -> Drawing:
    figure = canvas(3.2)
    axes = figure.subplots()
    figure.subplots_adjust(left=0.12, right=0.97, bottom=0.15, top=0.95)
    amplitude = table.amplitude_deg
    order = np.argsort(amplitude)
    axes.plot(amplitude, table.period_s, "o", color=DATA, label="measured")
    axes.plot(amplitude[order], table.circular_law_s[order], color=EXACT, label="ideal pendulum")
    axes.plot(
        amplitude[order],
        table.alpha_squared_over_16_s[order],
        "--",
        color=SMOOTH,
        label="1 + alpha²/16",
    )
    axes.set_xlabel("amplitude / degrees")
    axes.set_ylabel("period / s")
    axes.legend()
    return Drawing(
        "kind-period",
        "Period against amplitude",
        "Full periods beside the circular-error law with the fitted period at vanishing amplitude.",
        figure,
    )


def _plane(table: SwingPlane) -> Drawing:
    figure = canvas(2.6)
    axes = figure.subplots()
    figure.subplots_adjust(left=0.12, right=0.97, bottom=0.18, top=0.95)
    axes.plot(table.time_s, table.direction_deg, "o", color=DATA)
    axes.set_xlabel("time / s")
    axes.set_ylabel("direction / degrees")
    return Drawing(
        "kind-plane",
        "Turning of the swing plane",
        "Direction of the swing plane from the slow axis, period by period.",
        figure,
    )
