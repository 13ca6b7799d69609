"""Public data that lie beside the checkout, or where `RIG_SHARED_DATA` says."""

import os
from pathlib import Path

from tests.validation.row import Missing

_BESIDE = Path(__file__).resolve().parents[3].parent / "shared" / "data"


def shared(name: str) -> Path:
    """A file or folder of them. Raises `Missing`."""
    path = Path(os.environ.get("RIG_SHARED_DATA", _BESIDE)) / name
    if not path.exists():
        raise Missing(f"the public data {name}: in a folder that RIG_SHARED_DATA names")
    return path
