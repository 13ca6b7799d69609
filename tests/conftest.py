"""Order and limits of time of all tests, and fixtures that all may use."""

import gc
import os
import sys
import warnings
from collections import Counter
from collections.abc import Generator, Iterator
from itertools import islice
from pathlib import Path
from typing import Any

import pytest
from _pytest.approx import ApproxScalar
from hypothesis import settings
from xdist.scheduler import LoadFileScheduling

from tests.orphans import leave_no_orphans
from tests.shared_data import SHARED_DATA
from tests.signals import heed_signals

# Shared machines are slow at times: an example is not judged by the clock. CI repeats the same
# examples, a person's run looks for new ones.
settings.register_profile("here", deadline=None)
settings.register_profile("ci", deadline=None, derandomize=True, max_examples=50)
settings.load_profile("ci" if os.environ.get("CI") else "here")

# By default 1e-12 is near enough, and comparisons of joules or of m² could not fail.
ApproxScalar.DEFAULT_ABSOLUTE_TOLERANCE = 0.0

# Before numpy is imported, here and in every process started from here: threads of linear algebra, of several
# workers on few processors, wait for each other in loops and take up to five times the time.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

heed_signals()

# A test that is killed, by its limit of time or by hand, ends nothing any more.
leave_no_orphans()


LONG_S = 120
"""A test that states a limit of its own of so many seconds waits for long, and begins early."""
COMPUTING_BETWEEN = 4
"""Files that compute, those with most slow tests first, between two that wait for long."""
LONGER_S = {"kernel": 1500, "slow": 300, "realtime": 300}
"""Limits in s, for a busy machine, of tests that are marked so; the others have the one of pyproject.toml."""
WHOLE_SESSIONS = {"measured_series"}
"""Fixtures for which the first test that wants them may wait as long as a slow one."""
MEANWHILE = 8
"""Files that compute while the first that wants a whole session makes it: the others would wait for it."""


def pytest_xdist_auto_num_workers(config: pytest.Config) -> int:
    """Four workers more than processors (`-n auto`): slow tests wait for sessions in other processes."""
    return (os.cpu_count() or 1) + 4 * ("not slow" not in config.option.markexpr)


def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> LoadFileScheduling:
    """A file's tests run in one worker, since they share fixtures."""
    return LoadFileScheduling(config, log)


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Generator[None, object, object]:
    """Without searches for garbage, of which there is hardly any: they take a seventh of the time.

    What has been collected stays to the end, and is not searched with every test either.
    """
    gc.disable()
    try:
        return (yield)
    finally:
        gc.freeze()
        gc.enable()


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Limits of time, and the order of the files."""
    slow = Counter(item.path for item in items if item.get_closest_marker("slow"))
    real = {item.path for item in items if item.get_closest_marker("realtime")}
    long = {item.path for item in items for mark in item.iter_markers("timeout") if mark.args[0] >= LONG_S}
    for item in items:
        limit_s = max((limit for mark, limit in LONGER_S.items() if item.get_closest_marker(mark)), default=0)
        if WHOLE_SESSIONS & set(getattr(item, "fixturenames", ())):
            limit_s = max(limit_s, LONGER_S["slow"])
        if limit_s and not item.get_closest_marker("timeout"):
            item.add_marker(pytest.mark.timeout(limit_s))
    files = dict.fromkeys(item.path for item in items)
    whole = {item.path for item in items if WHOLE_SESSIONS & set(getattr(item, "fixturenames", ()))}
    waiting = iter([*real, *(path for path in files if path in long - real)])
    computing = sorted((path for path in files if path not in real | long), key=lambda path: -slow[path])
    first = [path for path in computing if path in whole][:1]
    first += [path for path in computing if path not in whole][:MEANWHILE]
    computing = [*first, *(path for path in computing if path not in first)]
    # were all that wait for long begun first, the processors would wait with them
    order: list[Path] = []
    for place, path in enumerate(computing):
        order += [*(islice(waiting, 1) if place % COMPUTING_BETWEEN == 0 else ()), path]
    places = {path: place for place, path in enumerate([*order, *waiting])}
    items.sort(key=lambda item: places[item.path])


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol(item: pytest.Item) -> Generator[None, bool | None, bool | None]:
    """What a test left open when it failed is closed here, and is no warning of whichever test comes next.

    A run that has ended lets searches for garbage find again what was collected; each takes half a second.
    """
    failed = item.session.testsfailed
    unfrozen = False

    def unfreeze() -> None:
        nonlocal unfrozen
        unfrozen = True
        gc_unfreeze()

    # noted, and not counted: counting a million objects takes a tenth of a second
    gc_unfreeze, gc.unfreeze = gc.unfreeze, unfreeze
    try:
        done = yield
    finally:
        gc.unfreeze = gc_unfreeze
    if unfrozen:
        # what the test itself has left is found first
        gc.collect(1)
        gc.freeze()
    if item.session.testsfailed > failed:
        sys.last_exc = sys.last_value = sys.last_traceback = None
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", ResourceWarning)
            gc.collect()
    return done


WRITTEN_WHERE_ONE_WORKS = ("audit.jsonl", "calibrations", "runs")
"""What the program writes into the current folder, or a folder there, where nothing else is stated."""


@pytest.fixture(scope="session", autouse=True)
def nothing_is_left_beside_the_tests() -> Iterator[None]:
    """A test works in a folder of its own: what is left here may be committed, or pass for somebody's log."""
    root = Path(__file__).resolve().parents[1]
    before = {name for name in WRITTEN_WHERE_ONE_WORKS if (root / name).exists()}
    yield
    left = {name for name in WRITTEN_WHERE_ONE_WORKS if (root / name).exists()} - before
    assert not left, f"a test has written {', '.join(sorted(left))} into {root}; give it a folder of its own"


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """Real images and decays that are not part of the project; skips where they are missing."""
    if not SHARED_DATA.is_dir():
        pytest.skip(f"no folder of real data at {SHARED_DATA}; set RIG_SHARED_DATA to one")
    return SHARED_DATA
