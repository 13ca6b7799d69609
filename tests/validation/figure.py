"""The figure of the page: shares that intervals hold, a line for each row, with its limits."""

from collections.abc import Mapping, Sequence
from io import BytesIO
from typing import Any

import matplotlib
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from tests.validation.kept import ROOT, Kept
from tests.validation.row import Row

FILE = ROOT / "docs" / "pictures" / "validation-coverage.svg"
_STYLE: dict[Any, Any] = {
    "svg.fonttype": "none",
    "svg.hashsalt": "optical-pendulum-rig",
    "font.family": "DejaVu Sans",
}
_NOMINAL_PERCENT = 68.27
_INK, _WRONG, _BAND = "#0072B2", "#D55E00", "#E8EAED"


def coverage_svg(rows: Sequence[Row], kept: Mapping[str, Kept]) -> bytes:
    """Rows with a share that were measured, from top to bottom."""
    drawn = [row for row in rows if row.share and row.name in kept]
    with matplotlib.rc_context(_STYLE):
        figure = Figure(figsize=(8, 0.9 + 0.42 * len(drawn)), layout="constrained")
        FigureCanvasAgg(figure)
        axes = figure.subplots()
        for place, row in enumerate(drawn):
            axes.barh(place, row.limit.high - row.limit.low, 0.7, row.limit.low, color=_BAND)
            for value in kept[row.name].values:
                inside = row.limit.low <= value <= row.limit.high
                axes.plot(value, place, "o", ms=4, alpha=0.7, mew=0, color=_INK if inside else _WRONG)
        axes.axvline(_NOMINAL_PERCENT, color="#333333", lw=0.8)
        axes.set_yticks(range(len(drawn)), [row.name for row in drawn])
        axes.invert_yaxis()
        axes.set_xlabel("within one standard uncertainty / %")
        for side in ("top", "right"):
            axes.spines[side].set_visible(False)
        out = BytesIO()
        figure.savefig(out, format="svg", metadata={"Date": None})
    return out.getvalue()
