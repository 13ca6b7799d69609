"""What all drawings are made of: a sheet, words, arrows, boxes."""

from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patches import FancyBboxPatch

INK, RED, BLUE, GREY, PALE = "#333333", "#D55E00", "#0072B2", "#8A8F98", "#E8EAED"
STYLE = {"svg.fonttype": "none", "svg.hashsalt": "optical-pendulum-rig", "font.family": "DejaVu Sans"}


def sheet(width: float, height: float) -> tuple[Figure, Axes]:
    """A white sheet measured in its own units, a hundred to the inch."""
    figure = Figure(figsize=(width / 100, height / 100))
    FigureCanvasAgg(figure)
    axes = figure.add_axes((0, 0, 1, 1), xlim=(0, width), ylim=(0, height), aspect="equal")
    axes.axis("off")
    return figure, axes


def label(axes: Axes, x: float, y: float, text: str, *, to: tuple[float, float] | None = None) -> None:
    """Words, with a thin line to what they name."""
    if to is None:
        axes.text(x, y, text, ha="center", va="center", color=INK, fontsize=9)
    else:
        line = {"arrowstyle": "-", "color": GREY, "lw": 0.7, "shrinkA": 1, "shrinkB": 0}
        axes.annotate(text, to, (x, y), ha="center", va="center", color=INK, fontsize=9, arrowprops=line)


def arrow(axes: Axes, start: tuple[float, float], end: tuple[float, float], colour: str = INK) -> None:
    """From one point to another."""
    axes.annotate("", end, start, arrowprops={"arrowstyle": "-|>", "color": colour, "lw": 1.3})


def box(axes: Axes, x: float, y: float, wide: float, high: float, name: str, gives: str) -> None:
    """A step, and what it gives."""
    axes.add_patch(
        FancyBboxPatch((x, y), wide, high, boxstyle="round,pad=1,rounding_size=6", fc=PALE, ec=GREY)
    )
    axes.text(
        x + wide / 2, y + high - 20, name, ha="center", va="center", fontsize=10, weight="bold", color=INK
    )
    axes.text(x + wide / 2, y + 18, gives, ha="center", va="center", fontsize=8.5, color=INK)
