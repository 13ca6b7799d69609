"""Draws optics, pendulum, the data's way and the light's supply, as SVG beside this file: make drawings."""

import io
import sys
from collections.abc import Callable
from pathlib import Path

import matplotlib as mpl
from matplotlib.figure import Figure
from matplotlib.patches import Circle, FancyBboxPatch, Polygon, Rectangle

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE))

from light_chain import light_chain  # noqa: E402
from sheet import BLUE, GREY, INK, PALE, RED, STYLE, arrow, box, label, sheet  # noqa: E402


def pendulum() -> Figure:
    """The pendulum from the side and from above."""
    figure, axes = sheet(800, 420)
    label(axes, 90, 400, "from the side")
    axes.add_patch(Rectangle((300, 215), 200, 26, color=PALE, ec=GREY))
    axes.add_patch(Circle((400, 251), 10, fc="white", ec=INK, zorder=3))
    axes.add_patch(Rectangle((345, 258), 110, 14, fc=PALE, ec=INK))
    for side in (-1, 1):
        reach = 400 + side * 45
        axes.plot([reach, 400 + side * 75, 400 + side * 300], [265, 241, 241], color=INK, lw=5, zorder=2)
        axes.add_patch(Rectangle((400 + side * 290 - 18, 227), 36, 28, fc=GREY, ec=INK, zorder=3))
    axes.add_patch(Rectangle((392, 272), 16, 26, fc=BLUE, ec=INK))
    label(axes, 500, 320, "mirror", to=(408, 290))
    label(axes, 610, 190, "flat (the sample)", to=(490, 222))
    label(axes, 260, 180, "ball, R = 6.05 mm", to=(394, 245))
    label(axes, 200, 330, "weights on screws: height of the mass centre, rest position", to=(112, 256))
    axes.plot([400, 400], [160, 241], color=RED, ls=":", lw=1)
    label(axes, 400, 152, "the mass centre lies on the contact spot")
    label(axes, 90, 125, "from above")
    axes.add_patch(Rectangle((92, 62), 616, 12, fc=PALE, ec=INK))
    for x in (110, 690):
        axes.add_patch(Rectangle((x - 18, 50), 36, 36, fc=GREY, ec=INK))
    axes.add_patch(Circle((400, 68), 10, fc="white", ec=INK, zorder=3))
    arrow(axes, (400, 68), (590, 68), RED)
    arrow(axes, (400, 68), (400, 120), BLUE)
    label(axes, 575, 100, "U, the long axis: the fast mode, X(t), T/5")
    label(axes, 280, 110, "V: the slow mode, Y(t), T = 4.07 s")
    label(axes, 400, 20, "moments of inertia about V and U as 25 : 1; 0.406 kg in all")
    return figure


def optics() -> Figure:
    """The light lever, and what a tilt does."""
    figure, axes = sheet(800, 360)
    mirror, sensor = (130, 150), (640, 232)
    axes.add_patch(Rectangle((40, 60), 180, 20, color=PALE, ec=GREY))
    axes.add_patch(Circle((130, 89), 9, fc="white", ec=INK))
    axes.add_patch(Rectangle((50, 98), 160, 9, fc=PALE, ec=INK))
    axes.add_patch(Polygon([(124, 107), (136, 107), (136, 180), (124, 180)], fc=BLUE, ec=INK))
    label(axes, 130, 40, "pendulum, tilted by φ")
    label(axes, 60, 210, "mirror", to=(125, 175))
    axes.add_patch(Rectangle((640, 60), 90, 26, fc=GREY, ec=INK))
    label(axes, 685, 40, "laser, class 2")
    axes.add_patch(FancyBboxPatch((560, 70), 8, 36, boxstyle="round,pad=2", fc="white", ec=INK))
    label(axes, 565, 128, "lens: the spot a few px wide on the sensor", to=(565, 106))
    axes.plot([640, 137], [75, 150], color=RED, lw=1.5)
    arrow(axes, (640, 75), (400, 111), RED)
    axes.plot([137, sensor[0]], [mirror[1], sensor[1]], color=RED, lw=1.5)
    axes.plot([137, sensor[0]], [mirror[1], 300], color=RED, lw=1.5, ls="--")
    label(axes, 360, 206, "2φ")
    label(axes, 430, 178, "arm L = 1 m")
    axes.add_patch(Rectangle((640, 190), 12, 140, fc=INK))
    axes.add_patch(Rectangle((652, 210), 70, 100, fc=PALE, ec=GREY))
    label(axes, 690, 345, "bare CMOS, no cover glass", to=(648, 326))
    axes.annotate("", (632, 300), (632, 232), arrowprops={"arrowstyle": "<->", "color": INK})
    label(axes, 480, 318, "spot moves by L tan 2φ: 2.02 px per arcsec", to=(630, 272))
    return figure


def data_way() -> Figure:
    """From photons to parameters."""
    figure, axes = sheet(900, 400)
    top = [
        ("camera", "frames, DN"),
        ("tracker", "spot, px ± u"),
        ("lever, axes", "tilt, arcsec ± u"),
        ("swing detector", "turning points"),
        ("two fits", "b p c n T₀ γ ± u"),
        ("results", "σ, budget, report"),
    ]
    wide, high, left, step, row = 118, 62, 12, 148, 235
    for place, (name, gives) in enumerate(top):
        x = left + place * step
        box(axes, x, row, wide, high, name, gives)
        if place:
            arrow(axes, (x - step + wide + 2, row + high / 2), (x - 2, row + high / 2))
    inputs = [(1, "sensor: gain, noise"), (2, "lever, axes, shutter"), (3, "clock"), (4, "mass, R, E, ν")]
    for place, text in inputs:
        x = left + place * step + wide / 2
        label(axes, x, 355, text)
        arrow(axes, (x, 343), (x, row + high + 3), BLUE)
    label(axes, 66, 355, "measured before:")
    box(
        axes,
        left + step,
        70,
        2 * step + wide,
        high,
        "record, run-1.mcap",
        "every spot, pixels around it, swings, events",
    )
    for place in (1, 2, 3):
        x = left + place * step + wide / 2
        arrow(axes, (x, row - 2), (x, 70 + high + 3), GREY)
    box(axes, left + 4 * step, 70, step + wide, high, "live view", "drops when slow, delays nothing")
    end = left + 3 * step + wide
    arrow(axes, (end + 2, 90), (left + 4 * step - 3, 90), GREY)
    arrow(axes, (end + 2, 125), (left + 4 * step + wide / 2, row - 3), RED)
    label(
        axes,
        450,
        30,
        "rig fit and rig replay begin at the record: the same pipeline, the same numbers, bit for bit",
    )
    return figure


DRAWINGS: dict[str, Callable[[], Figure]] = {
    "pendulum": pendulum,
    "optics": optics,
    "data-way": data_way,
    "light-chain": light_chain,
}


def svg(draw: Callable[[], Figure]) -> bytes:
    """A drawing as SVG; the same drawing gives the same bytes."""
    out = io.BytesIO()
    with mpl.rc_context(STYLE):
        draw().savefig(out, format="svg", facecolor="white", metadata={"Date": None, "Creator": None})
    return out.getvalue()


if __name__ == "__main__":
    for name, draw in DRAWINGS.items():
        (HERE / f"{name}.svg").write_bytes(svg(draw))
        print(f"{name}.svg")
