"""The figures of a report, for a notebook."""

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from rig.report import draw_run, styled

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def figures(source: str | Path, run: int = 1) -> "Mapping[str, Figure]":
    """Figures of one run of a session, by the names that their files have in a report.

    Parameters
    ----------
    source
        Folder of a session, or a results file.
    run
        Number of the run, counted from 1.

    Returns
    -------
    Mapping of str to matplotlib.figure.Figure
        A notebook displays the figures; `savefig` writes them.

    Raises
    ------
    RigError
        There are no results or no such run, or a record is missing.
    """
    with styled():
        return {drawing.name: drawing.figure for drawing in draw_run(Path(source), run)}
