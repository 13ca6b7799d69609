"""Axes of figures follow from what is drawn, and no label is cut; the numbers in pictures of the ground."""

from dataclasses import replace
from threading import Event, Thread

import matplotlib as mpl
import numpy as np
import pytest

from processing.swing import TurningPoints
from rig.analysis import Curves, ModelCurve
from rig.report.drawing import ReportFigure, amplitude_axis, canvas, nonnegative_limits, png, styled
from rig.report.figures_laws import decay_figure, loss_figure, period_figure, residual_figure
from rig.report.paper import PAIRS
from rig.report.source import DisplayUnit

ARCSEC = np.pi / 648000


def curves(first: float, last: float) -> tuple[TurningPoints, Curves]:
    """A decay between two amplitudes in arcsec, with periods that grow by a quarter of a per cent."""
    amplitude = np.linspace(first, last, 40) * ARCSEC
    index = np.arange(40, dtype=np.int64)
    period = 4.07 * (1 + 4.0 * amplitude)
    points = TurningPoints(index, 2.0 * index, np.full(40, 1e-5), amplitude, np.full(40, 1e-9))
    curve = ModelCurve.of(points, amplitude, points.time_s)
    found = Curves(
        asymptotic=curve, exact=curve, period_rad=amplitude,
        period_s=period, u_period_s=np.full(40, 1e-6), asymptotic_period_s=period, exact_period_s=period,
        smooth_s=period,
    )  # fmt: skip
    return points, found


def test_losses_are_of_the_cycles_that_are_stated() -> None:
    """With gaps the losses were those of one cycle, and called those of two."""
    index = np.delete(np.arange(340, dtype=np.int64), np.s_[4::4])
    amplitude = 100.0 * ARCSEC * np.exp(-0.003 * index)
    points = TurningPoints(index, 2.0 * index, np.full(256, 1e-5), amplitude, np.full(256, 1e-9))
    axes = loss_figure(points, PAIRS[0].parameters, PAIRS[0].pendulum).figure.axes[1]
    assert "measured, 1 cycle each" in axes.get_legend_handles_labels()[1]


@pytest.mark.parametrize(("first", "last"), [(140.0, 101.0), (124.0, 2.0), (5.0, 4.9)])
def test_little_of_a_period_figure_is_blank(first: float, last: float) -> None:
    points, found = curves(first, last)
    axes = period_figure(found).figure.axes[0]
    x = np.concatenate([np.asarray(line.get_xdata(), dtype=float) for line in axes.lines])
    low, high = axes.get_xlim()
    assert np.nanmax(x) - np.nanmin(x) > 0.9 * (high - low)
    assert sum(low <= tick <= high for tick in axes.get_xticks()) >= 3
    low, high = decay_figure(points, found, DisplayUnit("arcsec", ARCSEC)).figure.axes[0].get_ylim()
    assert (high - low) < 1.2 * max(first - last, 0.0 if low else high)


def test_an_axis_of_amplitudes_has_marks_and_limits_begin_at_zero_where_values_come_near_it() -> None:
    for low, high in ((101.0, 140.0), (2.0, 124.0), (0.4, 1.3), (900.0, 30_000.0)):
        axes = canvas(2.0).subplots()
        amplitude_axis(axes, low, high)
        start, end = axes.get_xlim()
        assert start <= low < high <= end
        assert sum(start <= tick <= end for tick in axes.get_xticks()) >= 3
    assert nonnegative_limits(np.array([2.0, 124.0]))[0] == 0.0
    assert nonnegative_limits(np.array([101.0, 140.0]))[0] == pytest.approx(101.0, abs=1.0)
    assert nonnegative_limits(np.array([np.nan])) == (0.0, 1.0)
    low, high = nonnegative_limits(np.array([7.0, 7.0]))
    assert low < 7.0 < high


def test_no_label_is_cut() -> None:
    with styled():
        figure = canvas(2.0)
        axes = figure.subplots()
        axes.plot([0, 1], [4.1715123, 4.1715124])
        axes.ticklabel_format(axis="y", useOffset=False)
        axes.set_ylabel("a long label")
        axes.set_xlabel("x")
        png(ReportFigure("a", "a", "a", figure), dpi=50)
        box = figure.get_tightbbox()
    assert box.x0 >= 0
    assert box.y0 >= 0
    assert box.x1 <= figure.get_figwidth()


def test_the_rms_of_residuals_contains_their_mean() -> None:
    """It was the standard deviation: residuals that all lie 3 u to one side stood as 0.00."""
    points, found = curves(124.0, 2.0)
    exact = replace(found.exact, model_amplitude_rad=points.amplitude - 3 * points.u_amplitude)
    off = replace(found, exact=exact)
    words = [text.get_text() for axes in residual_figure(points, off, ()).figure.axes for text in axes.texts]
    assert words == ["rms 3.00", "rms 0.00"]


def test_threads_that_draw_at_once_leave_no_style_behind() -> None:
    """A notebook that drew reports in threads had 8.5 pt in all of its own figures afterwards."""
    before = dict(mpl.rcParams)
    entered, leave = Event(), Event()

    def draws() -> None:
        with styled():
            entered.set()
            leave.wait()

    other = Thread(target=draws)
    with styled():
        other.start()
        # it has to wait for this one; with a style that both may have it would be inside long before
        assert not entered.wait(0.1)
    leave.set()
    other.join()
    assert dict(mpl.rcParams) == before
