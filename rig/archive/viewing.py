"""`rig archive view`: runs of the archive laid over each other in the viewer."""

from collections.abc import Sequence
from pathlib import Path

from processing.errors import ConfigurationError
from rig.archive.chosen import chosen_runs
from rig.rerun import ShowMode
from rig.view import show_records

_MOST = 24
"""More colours cannot be told apart, and each record is read whole."""


def view_runs(archive: Path, names: Sequence[str], where: str, mode: ShowMode, rrd: Path | None) -> None:
    """Show runs that are named or meet a condition in one viewer, or write its file.

    Raises ConfigurationError for none or too many, RecordError for a record that is not here.
    """
    records = list(chosen_runs(archive, names, where).values())
    if not 0 < len(records) <= _MOST:
        raise ConfigurationError(f"{len(records)} runs are meant; 1 to {_MOST} can be seen over each other")
    show_records(records, mode=mode, rrd=rrd)
    if rrd is not None:
        print(f"Rerun file   {rrd}")
