"""Where the real data are that are no part of the project: beside the checkout, or in RIG_SHARED_DATA."""

import os
from pathlib import Path

SHARED_DATA = Path(os.environ.get("RIG_SHARED_DATA", Path(__file__).resolve().parents[2] / "shared" / "data"))
