"""Public data that lie beside the checkout, or where `RIG_SHARED_DATA` says."""

from pathlib import Path

from tests.shared_data import SHARED_DATA
from tests.validation.row import Missing


def shared(name: str) -> Path:
    """A file or folder of them. Raises `Missing`."""
    path = SHARED_DATA / name
    if not path.exists():
        raise Missing(f"the public data {name}: in a folder that RIG_SHARED_DATA names")
    return path
