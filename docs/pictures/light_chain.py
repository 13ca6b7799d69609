"""Draws the wiring that takes the light away: one relay, and two with a test at each start."""

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from sheet import BLUE, GREY, INK, RED, arrow, box, label, sheet


def light_chain() -> Figure:
    """The chain with one relay above, the extended one below."""
    figure, axes = sheet(900, 640)
    _title(axes, 620, "One channel")
    _loop(axes, 565, "+24 V", ["fuse", "E-stop", "cover", "door", "reset ∥ K1"], "coil K1", INK)
    _loop(axes, 500, "laser supply", ["key", "K1", "K3"], "laser", RED)
    label(axes, 700, 520, "emission lamp across the laser's own supply")
    label(axes, 700, 480, "GP3 drives K3; GP8 sees a contact of K1")
    axes.plot([14, 886], [440, 440], color=GREY, lw=0.7, ls=":")
    _title(axes, 410, "Two channels, tested at each start")
    _loop(axes, 355, "+24 V", ["fuse 1", "E-stop a", "cover a", "door a", "start ∥ K1"], "coil K1", INK)
    _loop(axes, 295, "+24 V", ["fuse 2", "E-stop b", "cover b", "door b", "start ∥ K2"], "coil K2", INK)
    _loop(axes, 235, "start line", ["reset", "K1 is off", "K2 is off", "K3 is off"], "start", BLUE)
    label(axes, 725, 235, "a welded relay: no start")
    _loop(axes, 165, "laser supply", ["key", "K1", "K2", "K3"], "laser", RED)
    parts = [
        ("GP2, 100 kHz", "no edges: off"),
        ("one-shot, 1 ms", "each edge retriggers"),
        ("AND", "with GP3"),
    ]
    for place, (name, gives) in enumerate([*parts, ("coil K3", "dynamic enable")]):
        x = 24 + place * 220
        box(axes, x, 30, 170, 56, name, gives)
        if place:
            arrow(axes, (x - 48, 58), (x - 2, 58), BLUE)
    return figure


def _title(axes: Axes, y: float, text: str) -> None:
    axes.text(14, y, text, fontsize=11, weight="bold", color=INK, va="center")


def _loop(axes: Axes, y: float, begins: str, contacts: list[str], ends: str, colour: str) -> None:
    """Contacts in series, all of which must be closed, and what they feed."""
    end = 110 + 105 * len(contacts)
    axes.plot([95, end], [y, y], color=colour, lw=1.4, zorder=1)
    label(axes, 50, y, begins)
    for place, name in enumerate(contacts):
        x = 110 + place * 105
        axes.add_patch(Rectangle((x, y - 13), 85, 26, fc="white", ec=colour, zorder=2))
        label(axes, x + 42, y, name)
    axes.add_patch(Rectangle((end, y - 17), 74, 34, fc="white", ec=colour, lw=2, zorder=2))
    axes.text(end + 37, y, ends, ha="center", va="center", fontsize=9, weight="bold", color=INK)
