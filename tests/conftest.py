"""Fixtures of all tests: the folder of real data, if it exists."""

import os
import signal
from collections.abc import Generator
from pathlib import Path
from types import FrameType

import pytest
from hypothesis import settings

# Shared machines are slow at times: an example is not judged by the clock. CI repeats the same
# examples, a person's run looks for new ones.
settings.register_profile("here", deadline=None)
settings.register_profile("ci", deadline=None, derandomize=True)
settings.load_profile("ci" if os.environ.get("CI") else "here")

# A background job of a shell ignores Ctrl-C, and every process that is started from it would, too.
signal.signal(signal.SIGINT, signal.default_int_handler)


LONGEST_TEST_S = 900
LONGEST_KERNEL_TEST_S = 1500


class HangsError(Exception):
    """A test waits for what will not come; it fails where it stands, and the others go on."""


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol(item: pytest.Item) -> Generator[None, object, object]:
    """No test, with what it needs, takes longer than a quarter of an hour; booting a kernel may."""
    if not hasattr(signal, "setitimer"):
        return (yield)
    limit_s = LONGEST_KERNEL_TEST_S if item.get_closest_marker("kernel") else LONGEST_TEST_S

    def give_up(number: int, frame: FrameType | None) -> None:
        raise HangsError(f"{item.nodeid}: not done after {limit_s} s")

    before = signal.signal(signal.SIGALRM, give_up)
    signal.setitimer(signal.ITIMER_REAL, limit_s)
    try:
        return (yield)
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, before)


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """Real images and decays that are not part of the project; skips where they are missing."""
    default = Path(__file__).resolve().parent.parent.parent / "shared" / "data"
    folder = Path(os.environ.get("RIG_SHARED_DATA", default))
    if not folder.is_dir():
        pytest.skip(f"no folder of real data at {folder}; set RIG_SHARED_DATA to one")
    return folder
