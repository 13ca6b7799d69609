"""The trajectory in its own axes: trails, present position, and axes that follow the amplitude."""

import numpy as np
import rerun as rr

from rig.view import layout
from rig.view.gathering import Gathering
from rig.view.graticule import PLANE_REACH, reach_beyond, trajectory_graticule
from rig.view.marks import faded, graticule_marks
from rig.view.messages import Floats
from rig.view.trail import Trail

BRIGHTNESS = {"recent": 1.0, "older": 0.5, "oldest": 0.22}
HYSTERESIS = 0.9
"""The axes step down when the amplitude is so much below where they would step up again."""


class Lissajous:
    """Draws (X, Y) of one or several runs, stored once and seen at equal scales and with X stretched.

    Parameters
    ----------
    stream, gathered
        Where static entities go, and where the trails do.
    unit
        Unit of the deflections, for the labels.
    amplitude
        Expected at the start: the axes reach beyond it.
    follows
        Whether the axes follow the amplitude. Runs laid over each other have one set of axes.
    """

    def __init__(
        self, stream: rr.RecordingStream, gathered: Gathering, unit: str, amplitude: float, follows: bool
    ) -> None:
        self._stream = stream
        self._gathered = gathered
        self._unit = unit
        self._follows = follows
        self._reach = reach_beyond(amplitude)
        self._trails: dict[str, Trail] = {}
        stretch = rr.Transform3D(scale=[layout.X_STRETCH, 1.0, 1.0])
        stream.log(layout.EQUAL, stretch, static=True)
        if not follows:
            self._draw_axes(static=True)
        else:
            stream.set_time(layout.TIMELINE, duration=0.0)
            self._draw_axes(static=False)

    def draw(self, run: str, time_s: Floats, x: Floats, y: Floats, colour: str) -> None:
        """Draw on; NaN breaks the line."""
        # y points down in Rerun's spatial views.
        ends, pieces = self._trail(run, colour).pieces(time_s, np.column_stack((x, -y)))
        if not pieces:
            return
        for part in layout.TRAIL:
            self._gathered.strips(layout.trail_entity(run, part), ends, pieces)
        self._gathered.points(
            layout.trail_entity(run, layout.POSITION), ends, [piece[-1] for piece in pieces]
        )

    def follow(self, time_s: float, amplitude: float) -> None:
        """Choose the axes anew for the amplitude at this time."""
        reach = reach_beyond(amplitude / HYSTERESIS)
        outgrown = 1.02 * amplitude > self._reach
        if not self._follows or not (outgrown or reach < self._reach):
            return
        self._reach = reach
        self._stream.set_time(layout.TIMELINE, duration=time_s)
        self._draw_axes(static=False)

    def _trail(self, run: str, colour: str) -> Trail:
        if run not in self._trails:
            self._trails[run] = Trail()
            for order, (part, brightness) in enumerate(BRIGHTNESS.items()):
                style = rr.LineStrips2D.from_fields(
                    colors=faded(colour, brightness),
                    radii=rr.Radius.ui_points(0.9),
                    draw_order=float(10 - order),
                )
                self._stream.log(layout.trail_entity(run, part), style, static=True)
            dot = rr.Points2D.from_fields(
                colors=(255, 255, 255), radii=rr.Radius.ui_points(4.0), draw_order=20.0
            )
            self._stream.log(layout.trail_entity(run, layout.POSITION), dot, static=True)
        return self._trails[run]

    def _draw_axes(self, *, static: bool) -> None:
        scale = PLANE_REACH / self._reach
        zoom = rr.Transform3D(scale=[scale, scale, 1.0])
        self._stream.log(layout.TRAJECTORY, zoom, static=static)
        for root, stretch in ((layout.EQUAL, 1.0), (layout.STRETCHED, layout.X_STRETCH)):
            graticule = trajectory_graticule(self._reach, self._unit, stretch)
            for name, mark in graticule_marks(graticule).items():
                self._stream.log(f"{root}/graticule/{name}", mark, static=static)
