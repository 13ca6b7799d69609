"""The commands `rig archive`: a catalogue of the runs of many sessions."""

from typing import TYPE_CHECKING, Any

from rig.archive.adding import add_sessions
from rig.archive.blind import unseal
from rig.archive.blinding import blind_runs
from rig.archive.campaigned import RunWithResults, is_sealed, results_of_runs
from rig.archive.chosen import remark, show_runs, view_runs
from rig.archive.cluster import client_of
from rig.archive.listing import Format, list_runs
from rig.archive.plot import plot_runs
from rig.archive.remote import brought, is_remote, opened

if TYPE_CHECKING:
    from rig.archive.checking import check_archive
    from rig.archive.crates import Statement
    from rig.archive.differences import print_differences
    from rig.archive.finding import FoundRuns, find_runs
    from rig.archive.laboratories import compare_groups
    from rig.archive.publishing import publish_runs
    from rig.archive.refits import code_identity
    from rig.archive.refitting import refit_runs

_LATER = {
    "FoundRuns": "finding",
    "Statement": "crates",
    "check_archive": "checking",
    "code_identity": "refits",
    "compare_groups": "laboratories",
    "find_runs": "finding",
    "print_differences": "differences",
    "publish_runs": "publishing",
    "refit_runs": "refitting",
}
"""What takes seconds to import, for which `list` must not wait, by module."""


def __getattr__(name: str) -> Any:
    if name not in _LATER:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from importlib import import_module

    return getattr(import_module(f"{__name__}.{_LATER[name]}"), name)
