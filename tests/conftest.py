"""Fixtures of all tests: the folder of real data, if it exists."""

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

# A background job of a shell ignores Ctrl-C, and one under nohup a closed terminal; every process that is
# started from here would ignore them, too. A signal with a handler has its default in the processes started.
signal.signal(signal.SIGINT, signal.default_int_handler)
if hasattr(signal, "SIGHUP") and signal.getsignal(signal.SIGHUP) is signal.SIG_IGN:
    signal.signal(signal.SIGHUP, lambda number, frame: None)


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Sort tests into the groups that one worker runs: what measures real time, and the others by file.

    Two tests of real time at once would disturb each other; the tests of a file share its fixtures.
    """
    for item in items:
        realtime = item.get_closest_marker("realtime") is not None
        if item.get_closest_marker("xdist_group") is None:
            item.add_marker(pytest.mark.xdist_group("realtime" if realtime else item.path.stem))


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """Real images and decays that are not part of the project; skips where they are missing."""
    default = Path(__file__).resolve().parent.parent.parent / "shared" / "data"
    folder = Path(os.environ.get("RIG_SHARED_DATA", default))
    if not folder.is_dir():
        pytest.skip(f"no folder of real data at {folder}; set RIG_SHARED_DATA to one")
    return folder
