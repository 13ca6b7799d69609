"""The figures of a report, for a notebook."""

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from rig.report import draw_run, styled

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def figures(source: str | Path, run: int = 1) -> "Mapping[str, Figure]":
    """The figures of one run of a session, counted from 1, by the names that their files have in a report.

    `source` is a session's folder or a results file. A matplotlib figure shows itself in a notebook, and
    `savefig` writes it.

    Raises
    ------
    RigError
        No results, no such run, or a record that is missing.
    """
    with styled():
        return {drawing.name: drawing.figure for drawing in draw_run(Path(source), run)}
