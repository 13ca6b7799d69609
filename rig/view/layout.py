"""Entity paths of Rerun, and the three layouts of panels.

The y axis of Rerun's spatial views points down: points are therefore plotted at -Y, while the labels of the
graticule show +Y.

The trajectory is stored once, in the unit of the setup, and shown in two views. Its entity TRAJECTORY has a
transform that scales the present amplitude to the axes (150, 100, 70, 50 arcsec ... as the swing decays); its
parent EQUAL has one that stretches X. Rerun applies the transforms below a view's origin: a view with the
origin EQUAL has equal scales, one with the origin STRETCHED shows X stretched.
"""

from collections.abc import Mapping, Sequence
from typing import Final, NamedTuple

import rerun as rr
import rerun.blueprint as rrb

from rig.terminal import balance_panels
from rig.view.graticule import BACKGROUND, BOX, PLANE_REACH
from rig.view.running_view import LayoutName

APPLICATION_ID: Final = "optical_pendulum_rig"
TIMELINE: Final = "run_time"

STRETCHED: Final = "/lissajous"
EQUAL: Final = "/lissajous/equal"
TRAJECTORY: Final = "/lissajous/equal/trajectory"
X_STRETCH: Final = 10.0
TRAIL: Final = {"recent": (0.0, 2.0), "older": (2.0, 8.0), "oldest": (8.0, 28.0)}
"""Parts of the trajectory of decreasing brightness, and the periods before the time cursor that they show."""
POSITION: Final = "position"

X: Final = "/deflection/x"
FAST: Final = "/deflection/x/fast_mode"
LEAKAGE: Final = "/deflection/x/leakage"
"""The two parts of X, entities below it."""
Y: Final = "/deflection/y"
AMPLITUDE: Final = "/amplitude"
PERIOD: Final = "/period"
CAMERA: Final = "/camera"
IMAGE: Final = "/camera/image"
SPOT: Final = "/camera/spot"
REFERENCE: Final = "/reference"
"""Parent of x and y of the reference spot."""
BALANCE_ROOT: Final = "/balance"
LOSSES_ROOT: Final = "/losses"
PARAMETERS_ROOT: Final = "/parameters"
CLOCK: Final = "/clock"
LANES: Final = ("/run", "/spot", "/frames", "/laser")
"""Conditions of a run against time; the viewer titles a lane with its whole path."""
STATE: Final = "/state"
ADVICE: Final = "/advice"
BALANCE_TABLE: Final = "/balance_table"
EVENTS: Final = "/events"
ANALYSIS_ROOT: Final = "/analysis"
REPORT: Final = "/analysis/report"

WINDOW_S: Final = 30.0
"""Time span of X(t) and Y(t) that is shown before the time cursor."""
BALANCE_WINDOW_S: Final = 120.0
"""Time span of the balance before the time cursor: a longer one would hide the effect of the last turn."""
WHOLE_RUN: Final = rrb.TimeAxis(
    view_range=rr.TimeRange(start=rrb.TimeRangeBoundary.infinite(), end=rrb.TimeRangeBoundary.infinite())
)


class Setup(NamedTuple):
    """The values that a plot needs before its first data."""

    title: str
    layout: LayoutName = "measuring"
    period_s: float = 4.07
    """Expected period of the slow mode."""
    amplitude: float = 125.0
    """Expected amplitude, for the first axes."""
    unit: str = "arcsec"
    """Unit of all deflections."""
    parameters: Mapping[str, str] = {}
    """Labels, by key, of the parameters that are estimated during a run; each has a panel."""
    has_reference: bool = False
    """Whether there is a panel for the spot of a mirror on the base."""


def _window_axis(seconds: float) -> rrb.TimeAxis:
    """A time axis of this length that ends at the time cursor."""
    return rrb.TimeAxis(
        view_range=rr.TimeRange(
            start=rrb.TimeRangeBoundary.cursor_relative(seconds=-seconds),
            end=rrb.TimeRangeBoundary.cursor_relative(),
        )
    )


def blueprint(setup: Setup) -> rrb.Blueprint:
    """Layout of the panels."""
    views = _Views(setup)
    layouts = {"balancing": views.balancing, "measuring": views.measuring, "analysing": views.analysing}
    return rrb.Blueprint(
        layouts[setup.layout](),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        rrb.TimePanel(state="collapsed", timeline=TIMELINE, play_state="following"),
        auto_views=False,
        auto_layout=False,
    )


class _Views:
    """Builds the panels."""

    def __init__(self, setup: Setup) -> None:
        self._unit = setup.unit
        self._period_s = setup.period_s
        self._parameters = setup.parameters
        self._has_reference = setup.has_reference

    def measuring(self) -> rrb.Container:
        return rrb.Horizontal(
            rrb.Vertical(
                self.trajectory(),
                rrb.Horizontal(
                    self.history(LOSSES_ROOT, "Losses", has_legend=True),
                    self.history(CLOCK, "Clock drift / ppm"),
                    *self.reference_spot(),
                ),
                self.lanes(),
                self.events(),
                row_shares=[8, 3, 5, 3],
            ),
            rrb.Vertical(
                self.deflection(Y, "Y(t), slow mode"),
                self.deflection(X, "X(t), across the swing", has_legend=True),
                rrb.Horizontal(
                    self.history(AMPLITUDE, f"Amplitude / {self._unit}"), self.history(PERIOD, "Period / s")
                ),
                *self.parameters(),
            ),
            rrb.Vertical(
                self.camera(),
                self.text(BALANCE_TABLE, "Balance"),
                self.text(STATE, "State"),
                row_shares=[5, 8, 5],
            ),
            column_shares=[4, 5, 3],
        )

    def balancing(self) -> rrb.Container:
        return rrb.Horizontal(
            rrb.Vertical(self.trajectory(), self.stretched()),
            rrb.Grid(
                *(self.balance(title, names) for title, names in balance_panels(self._unit).items()),
                grid_columns=2,
            ),
            rrb.Vertical(
                self.text(ADVICE, "Advice"),
                self.text(BALANCE_TABLE, "Balance"),
                self.camera(),
                row_shares=[4, 8, 5],
            ),
            column_shares=[4, 5, 3],
        )

    def analysing(self) -> rrb.Container:
        unit = self._unit
        return rrb.Horizontal(
            rrb.Vertical(
                self.plane("decay", f"Decay: amplitude / {unit} against time / s"),
                self.plane("residuals", f"Residuals of the amplitude / {unit}"),
            ),
            rrb.Vertical(
                self.plane("period", f"T(α): period / s against amplitude / {unit}"),
                self.plane("period_residuals", "Residuals of the period / ms"),
            ),
            rrb.Vertical(self.trajectory(), self.text(REPORT, "Report")),
        )

    def trajectory(self) -> rrb.View:
        return self._lissajous(EQUAL, f"Trajectory / {self._unit}, equal scales")

    def stretched(self) -> rrb.View:
        return self._lissajous(STRETCHED, f"Trajectory / {self._unit}, X stretched {X_STRETCH:.0f} times")

    def _lissajous(self, origin: str, title: str) -> rrb.View:
        ranges: dict[rr.encodings.EntityPath | str, rrb.VisibleTimeRanges] = {}
        for name, (newest, oldest) in TRAIL.items():
            span = rrb.VisibleTimeRange(
                TIMELINE,
                start=rrb.TimeRangeBoundary.cursor_relative(seconds=-oldest * self._period_s),
                end=rrb.TimeRangeBoundary.cursor_relative(seconds=-newest * self._period_s),
            )
            ranges[f"{TRAJECTORY}/{name}"] = rrb.VisibleTimeRanges([span])
        # the labels need space below and to the left of the axes
        return rrb.Spatial2DView(
            name=title,
            origin=origin,
            contents=[f"+ {TRAJECTORY}/**", f"+ {origin}/graticule/**"],
            visual_bounds=rrb.VisualBounds2D(
                x_range=(-1.32 * PLANE_REACH, 1.15 * PLANE_REACH),
                y_range=(-1.06 * PLANE_REACH, 1.18 * PLANE_REACH),
            ),
            background=BACKGROUND,
            overrides=ranges,
        )

    def deflection(self, path: str, title: str, *, has_legend: bool = False) -> rrb.View:
        return _curves(f"{title} / {self._unit}", [path], _window_axis(WINDOW_S), has_legend)

    def history(self, path: str, title: str, *, has_legend: bool = False) -> rrb.View:
        return _curves(title, [path], WHOLE_RUN, has_legend)

    def parameters(self) -> list[rrb.Container]:
        """A grid of small panels for the parameters; empty without parameters."""
        panels = [self.history(f"{PARAMETERS_ROOT}/{key}", label) for key, label in self._parameters.items()]
        return [rrb.Grid(*panels, grid_columns=3)] if panels else []

    def reference_spot(self) -> list[rrb.View]:
        """The panel of the reference spot, with the drift of pointing, air and camera; empty without one."""
        if not self._has_reference:
            return []
        return [self.history(REFERENCE, "Reference spot / px", has_legend=True)]

    def balance(self, title: str, names: Sequence[str]) -> rrb.View:
        paths = [f"{BALANCE_ROOT}/{name}" for name in names]
        return _curves(title, paths, _window_axis(BALANCE_WINDOW_S), len(names) > 1)

    def lanes(self) -> rrb.View:
        contents = [f"+ {lane}" for lane in LANES]
        return rrb.StateTimelineView(name="Conditions", contents=contents, time_view=WHOLE_RUN)

    def camera(self) -> rrb.View:
        return rrb.Spatial2DView(name="Camera", contents=[_entities_below(CAMERA)])

    def plane(self, panel: str, title: str) -> rrb.View:
        return rrb.Spatial2DView(
            name=title,
            contents=[_entities_below(f"{ANALYSIS_ROOT}/{panel}")],
            visual_bounds=rrb.VisualBounds2D(
                x_range=(-0.2 * BOX[0], 1.03 * BOX[0]), y_range=(-1.11 * BOX[1], 0.19 * BOX[1])
            ),
            background=BACKGROUND,
        )

    def events(self) -> rrb.View:
        return rrb.TextLogView(
            name="Events",
            contents=[_entities_below(EVENTS)],
            columns=rrb.TextLogColumns(timeline_columns=[TIMELINE], text_log_columns=["loglevel", "body"]),
        )

    def text(self, path: str, title: str) -> rrb.View:
        return rrb.TextDocumentView(name=title, origin=path)


def _curves(title: str, paths: Sequence[str], axis: rrb.TimeAxis, has_legend: bool) -> rrb.View:
    """Curves against time."""
    legend = rrb.PlotLegend(rrb.Corner2D.LeftTop, visible=has_legend)
    return rrb.TimeSeriesView(
        name=title, contents=list(map(_entities_below, paths)), axis_x=axis, plot_legend=legend
    )


def _entities_below(path: str) -> str:
    return f"+ {path}/**"
