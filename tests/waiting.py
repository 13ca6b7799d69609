"""Waiting for states, never for durations."""

import time
from collections.abc import Callable

LIMIT_S = 200.0


def until(state: Callable[[], object]) -> None:
    """Return when `state()` is true; the limit is for a busy machine, and for what never comes about."""
    deadline_s = time.monotonic() + LIMIT_S
    while not state():
        assert time.monotonic() < deadline_s, "it did not come about"
        time.sleep(0.005)
