"""The commands `rig archive`: the runs of many sessions as rows of one DuckDB file."""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from rig.archive.listing import find_runs, list_runs, selected, show_runs

if TYPE_CHECKING:
    from rig.archive.updating import add_folders, check_archive, cluster_client, refit_runs, update_archive

_LAZY_MODULES = {"add_folders": "updating", "check_archive": "updating", "update_archive": "updating"}
_LAZY_MODULES |= {"cluster_client": "updating", "refit_runs": "updating"}
"""Names whose modules take seconds to import, for which `list` must not wait."""


if not TYPE_CHECKING:  # a type checker would take any name for one of this room

    def __getattr__(name: str) -> Any:
        if name not in _LAZY_MODULES:
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
        return getattr(import_module(f"{__name__}.{_LAZY_MODULES[name]}"), name)
