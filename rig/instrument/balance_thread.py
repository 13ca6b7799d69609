"""Estimates the balance beside the frames, because one estimate takes as long as many frames."""

from collections import deque
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor

from processing.balance import Balance
from processing.deflections import Deflections

_MOST_WAITING = 4096


class BalanceThread:
    """Calls `estimate` in a thread of its own, in order, and gives out its estimates when they are ready.

    They are the same estimates as without the thread. `estimate` is `BalanceEstimator.update`; an error in
    it is raised by a later call. Only when thousands of blocks wait does `update` wait too.
    """

    def __init__(self, estimate: Callable[[Deflections], list[Balance]]) -> None:
        self._estimate = estimate
        self._executor = ThreadPoolExecutor(1, thread_name_prefix="balance")
        self._asked: deque[Future[list[Balance]]] = deque()

    def update(self, deflections: Deflections) -> list[Balance]:
        """Add samples; returns the estimates that have become ready since the last call."""
        self._asked.append(self._executor.submit(self._estimate, deflections))
        found: list[Balance] = []
        while self._asked and (self._asked[0].done() or len(self._asked) > _MOST_WAITING):
            found += self._asked.popleft().result()
        return found

    def finish(self) -> list[Balance]:
        """Wait for the estimates that are still being made, and return them."""
        found = [balance for asked in self._asked for balance in asked.result()]
        self._asked.clear()
        self._executor.shutdown()
        return found
