"""The commands `rig archive`: the runs of many sessions as rows of one DuckDB file."""

from typing import TYPE_CHECKING, Any

from rig.archive.listing import FoundRuns, find_runs, list_runs, runs_in_order, show_runs

if TYPE_CHECKING:
    from rig.archive.refitting import client_of, refit_runs
    from rig.archive.updating import add_folders, check_archive, update_archive


def __getattr__(name: str) -> Any:
    # takes seconds to import, for which `list` must not wait
    if name in ("add_folders", "check_archive", "update_archive"):
        from rig.archive import updating as later
    elif name in ("client_of", "refit_runs"):
        from rig.archive import refitting as later
    else:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(later, name)
