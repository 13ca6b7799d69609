"""The wall before what only watches a run: what fails there is said once, counted, and ends nothing."""

import logging
from collections import Counter
from collections.abc import Callable
from typing import ParamSpec, TypeVar

_log = logging.getLogger(__name__)

Arguments = ParamSpec("Arguments")
Found = TypeVar("Found")

_MOST = 10
"""After so many failures in a row it is left out: what fails each time costs time each time."""


class Wall:
    """Calls what only watches: display, view, notices, forecast, live fit, balance.

    It may be used from several threads. `failures` counts by name.
    """

    def __init__(self) -> None:
        self.failures: Counter[str] = Counter()
        self._in_a_row: Counter[str] = Counter()
        self._news: list[str] = []

    def past(
        self,
        name: str,
        otherwise: Found,
        call: Callable[Arguments, Found],
        *args: Arguments.args,
        **words: Arguments.kwargs,
    ) -> Found:
        """What the call returns; `otherwise` where it raises an Exception, and where it is left out."""
        if self._in_a_row[name] >= _MOST:
            return otherwise
        try:
            found = call(*args, **words)
        except Exception as error:
            self.failures[name] += 1
            self._in_a_row[name] += 1
            why = f"{type(error).__name__}: {error}".splitlines()[0].rstrip(": ")
            if self.failures[name] == 1:
                _log.exception("%s has failed, the run goes on", name)
                self._news.append(f"{name} has failed, the run goes on: {why}")
            if self._in_a_row[name] == _MOST:
                self._news.append(f"{name} is left out after {_MOST} failures in a row")
            return otherwise
        self._in_a_row[name] = 0
        return found

    def take_news(self) -> list[str]:
        """What is to be said since the last call."""
        news, self._news = self._news, []
        return news

    @property
    def text(self) -> str:
        """How often what has failed; empty where nothing has."""
        return ", ".join(f"{name} {count} times" for name, count in sorted(self.failures.items()))
