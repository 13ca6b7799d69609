"""Which tab of the browser may act: one at a time, asked for, and kept over a reload."""

import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass

KEPT_S = 120.0
"""So long the role waits for a tab that was reloaded, or has lost its network."""
ANSWER_S = 15.0
"""So long a tab may say no before it is taken over."""


@dataclass(frozen=True, slots=True)
class Actor:
    """The tab that acts, who sits at it, and since when (time of the day in s); `asked_by` wants it."""

    tab: str
    name: str
    since_s: float
    here: bool = True
    asked_by: str = ""


class Acting:
    """Used by the desk's event loop only; `keep` is told who acts, so that a desk that comes again knows.

    A tab acts because it was opened while none did, or because somebody has asked for it there. Nobody gets
    it because another one has gone.
    """

    def __init__(
        self,
        last: str = "",
        keep: Callable[[str], None] = lambda _tab: None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._clock, self._keep = clock, keep
        self._tab, self._name, self._since_s = last, "", time.time()
        self._gone_s: float | None = clock() if last else None
        self._wanted: tuple[str, str, float] | None = None
        self._refused: set[str] = set()
        self._connections: Counter[str] = Counter()

    @property
    def now(self) -> Actor | None:
        """Who acts; None if nobody does."""
        self._decide()
        if not self._tab:
            return None
        asked = "" if self._wanted is None else self._wanted[1] or "somebody"
        return Actor(self._tab, self._name, self._since_s, self._gone_s is None, asked)

    def acts(self, tab: str) -> bool:
        """Whether this tab is the one that may act."""
        self._decide()
        return bool(tab) and self._tab == tab

    def arrived(self, tab: str, name: str) -> None:
        """A tab is connected; it acts if none does, or if it did when it was lost."""
        self._connections[tab] += 1
        if self._tab == tab:
            self._gone_s, self._name = None, name or self._name
        elif not self._tab or (self._gone_s is not None and self._clock() - self._gone_s > KEPT_S):
            self._give(tab, name)

    def called(self, tab: str, name: str) -> None:
        """Somebody has said who sits at a tab."""
        if self._tab == tab:
            self._name = name

    def left(self, tab: str) -> None:
        """A connection to a tab is lost; it may have another one, which came before this was missed."""
        self._connections[tab] -= 1
        if self._connections[tab] > 0:
            return
        del self._connections[tab]
        if self._tab == tab and self._gone_s is None:
            self._gone_s = self._clock()
        if self._wanted is not None and self._wanted[0] == tab:
            self._wanted = None

    def ask(self, tab: str, name: str) -> bool:
        """A tab wants to act; whether it does at once, because nobody is there who could say no."""
        if not self._tab or self._gone_s is not None:
            self._give(tab, name)
            return True
        if self._tab != tab and self._wanted is None:
            self._refused.discard(tab)
            self._wanted = tab, name, self._clock()
        return self._tab == tab

    def waits(self, tab: str) -> bool:
        """Whether this tab has asked, and no answer has come."""
        self._decide()
        return self._wanted is not None and self._wanted[0] == tab

    def refused(self, tab: str) -> bool:
        """Whether this tab was told no; once."""
        if tab in self._refused:
            self._refused.discard(tab)
            return True
        return False

    def answer(self, tab: str, *, give: bool) -> None:
        """The acting tab gives its role away, or keeps it."""
        if self._wanted is None or self._tab != tab:
            return
        wanted, name, _ = self._wanted
        if give:
            self._give(wanted, name)
        else:
            self._refused.add(wanted)
            self._wanted = None

    def _decide(self) -> None:
        """Whoever was asked and says nothing has left."""
        if self._wanted is not None and (
            self._gone_s is not None or self._clock() - self._wanted[2] > ANSWER_S
        ):
            self._give(*self._wanted[:2])

    def _give(self, tab: str, name: str) -> None:
        self._tab, self._name, self._since_s = tab, name, time.time()
        self._gone_s = self._wanted = None
        self._keep(tab)
