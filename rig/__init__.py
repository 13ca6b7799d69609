"""The optical pendulum rig; `import rig` gives scripts the names in `__all__` (docs/scripts.md).

Each name is imported when it is first used, so that `import rig` alone, and `rig --help`, load nothing.
"""

import importlib
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from processing.deflections import Deflections
    from processing.errors import RigError
    from rig.analysis import SessionResults, read_results, write_results
    from rig.scripting import (
        Campaign,
        Record,
        Session,
        campaign,
        curves,
        figures,
        fit,
        fit_film,
        fit_table,
        open_record,
        open_session,
    )

__all__ = [
    "Campaign", "Deflections", "Record", "RigError", "Session", "SessionResults", "campaign", "curves",
    "figures", "fit", "fit_film", "fit_table", "open_record", "open_session", "read_results", "write_results",
]  # fmt: skip
_MODULES = {
    "Deflections": "processing.deflections",
    "RigError": "processing.errors",
    "SessionResults": "rig.analysis",
    "read_results": "rig.analysis",
    "write_results": "rig.analysis",
}
"""Modules of the names; those that are not listed are in rig.scripting."""


def _refuse_foreign_packages() -> None:
    """Raise ImportError if another project's package hides one of this program with the same, common name."""
    root = Path(__file__).resolve().parent.parent
    for name in ("processing", "calibration", "acquisition"):
        spec = find_spec(name)
        path = None if spec is None or spec.origin is None else Path(spec.origin).resolve()
        if path is None or path.parent.parent != root:
            raise ImportError(
                f"the package {name!r} found first is {path or 'missing'}, not that beside {root / 'rig'}; "
                "rename the other, or install optical-pendulum-rig into an environment of its own"
            )


_refuse_foreign_packages()


def __getattr__(name: str) -> Any:
    if name not in __all__:
        raise AttributeError(f"module 'rig' has no attribute {name!r}")
    return getattr(importlib.import_module(_MODULES.get(name, "rig.scripting")), name)


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
