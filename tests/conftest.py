"""What all tests share: the folder of real data, where there is one."""

import os
import signal
from pathlib import Path

import pytest
from hypothesis import settings

# Shared machines are slow at times: an example is not judged by the clock. CI repeats the same
# examples, a person's run looks for new ones.
settings.register_profile("here", deadline=None)
settings.register_profile("ci", deadline=None, derandomize=True)
settings.load_profile("ci" if os.environ.get("CI") else "here")

# A background job of a shell ignores Ctrl-C, and every process that is started from it would, too.
signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """Real images and decays that are not part of the project; skips where they are missing."""
    default = Path(__file__).resolve().parent.parent.parent / "shared" / "data"
    folder = Path(os.environ.get("RIG_SHARED_DATA", default))
    if not folder.is_dir():
        pytest.skip(f"no folder of real data at {folder}; set RIG_SHARED_DATA to one")
    return folder
