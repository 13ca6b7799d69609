"""What the pictures of README and docs show, as hashes: of what is drawn, not of the code that draws it."""

import hashlib
import json
import tomllib
from pathlib import Path
from typing import Any, get_args

from matplotlib.colors import to_hex
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from rig.report import draw_run
from rig.view import LayoutName

ROOT = Path(__file__).resolve().parents[2]
PICTURES = ROOT / "docs" / "pictures"
DRAWN = PICTURES / "drawn.json"
"""The hashes at the time when the pictures were made."""
CONFIGURATION = ROOT / "configs" / "demo.toml"
RESULT_FIGURES = (("fig12-decay", "fig13-period"), ("table4-loops", "losses"))
_REFERENCES = ROOT / "tests" / "rig" / "view" / "data"
_RESULTS = ROOT / "tests" / "rig" / "data" / "samples" / "series"


def drawn_now() -> dict[str, str]:
    """A hash for each picture, and for the configuration of the run that they show.

    The view's layouts are known by their reference pictures, which a test holds against what is drawn; the
    report's figures by their axes, legends and curves, without numbers, which depend on the data.
    """
    views = {
        f"rerun-{layout}.png": _sha256((_REFERENCES / f"view-{layout}.png").read_bytes())
        for layout in get_args(LayoutName)
    }
    figures = {drawing.name: drawing.figure for drawing in draw_run(_RESULTS, 1)}
    wanted = [name for row in RESULT_FIGURES for name in row]
    return {
        **views,
        "result.png": _sha256_of([_described(figures[name]) for name in wanted]),
        CONFIGURATION.name: _sha256_of(tomllib.loads(CONFIGURATION.read_text(encoding="utf-8"))),
    }


def _described(figure: Figure) -> list[Any]:
    return [
        [
            *figure.get_size_inches().tolist(),
            [axes.get_title(), axes.get_xlabel(), axes.get_ylabel(), axes.get_xscale(), axes.get_yscale()],
            [text.get_text() for legend in [axes.get_legend()] if legend for text in legend.get_texts()],
            [_styled(line) for line in axes.lines],
            [type(artist).__name__ for artist in axes.collections],
        ]
        for axes in figure.axes
    ]


def _styled(line: Line2D) -> list[Any]:
    return [to_hex(line.get_color()), line.get_linestyle(), line.get_linewidth(), str(line.get_marker())]


def _sha256_of(tree: Any) -> str:
    return _sha256(json.dumps(tree, sort_keys=True).encode())


def _sha256(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()
