"""Estimates beside the frames, because one estimate takes as long as many frames."""

from collections import deque
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Generic, ParamSpec, TypeVar

Samples = ParamSpec("Samples")
Found = TypeVar("Found")

_MOST_WAITING = 4096


class BesideThread(Generic[Samples, Found]):
    """Calls `estimate` in a thread of its own, in order, and gives out its estimates when they are ready.

    They are the same estimates as without the thread. `estimate` is the `update` of a detector or estimator;
    an error in it is raised by a later call. Only when thousands of blocks wait does `update` wait too.
    """

    def __init__(self, estimate: Callable[Samples, list[Found]], name: str) -> None:
        self._estimate = estimate
        self._executor = ThreadPoolExecutor(1, thread_name_prefix=name)
        self._asked: deque[Future[list[Found]]] = deque()

    def update(self, *samples: Samples.args, **named: Samples.kwargs) -> list[Found]:
        """Add samples; returns the estimates that have become ready since the last call."""
        self._asked.append(self._executor.submit(self._estimate, *samples, **named))
        found: list[Found] = []
        while self._asked and (self._asked[0].done() or len(self._asked) > _MOST_WAITING):
            found += self._asked.popleft().result()
        return found

    def finish(self) -> list[Found]:
        """Wait for the estimates that are still being made, and return them."""
        found = [one for asked in self._asked for one in asked.result()]
        self._asked.clear()
        return found
