"""Errors of position over the stretch of sensor that the run swept."""

from rig.analysis import PositionErrors
from rig.report.drawing import DATA, INK, ReportFigure, canvas


def place_figure(found: PositionErrors) -> ReportFigure:
    """The map that was taken off, with its standard uncertainty."""
    size, unit = found.unit.shown_size, found.unit.shown
    place, error, u_error = found.place / size, found.error / size, found.u_error / size
    figure = canvas(2.3)
    axes = figure.add_subplot()
    axes.axhline(0.0, color=INK, lw=0.6, ls=":")
    axes.fill_between(place, error - u_error, error + u_error, color=DATA, alpha=0.3, lw=0)
    axes.plot(place, error, color=DATA, lw=0.9)
    axes.set_xlim(place[0], place[-1])
    axes.set_xlabel(f"deflection / {unit}")
    axes.set_ylabel(f"error / {unit}")
    figure.subplots_adjust(left=0.11, right=0.985, bottom=0.2, top=0.95)
    words = (
        "What was measured too much at each place of the sensor, with its standard uncertainty, from the "
        f"residuals of {found.cycles} whole cycles, each of which passes every place twice. It was taken off "
        "before the turning points were measured again. A constant and a scale cannot be seen in a free "
        "swing; the budget holds them with the rest."
    )
    return ReportFigure("position-errors", "Errors of position on the sensor", words, figure)
