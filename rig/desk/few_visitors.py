"""Connections to the desk's page that a crowd of silent ones cannot use up.

Whoever reaches the port may connect without a key, and say nothing: each connection takes an open file of the
desk, until it can open none of its own, not even to switch something off.
"""

import asyncio

from uvicorn.protocols.http.httptools_impl import HttpToolsProtocol

MOST_VISITORS = 256
"""More than the browsers of one laboratory open; those of pages that are open are not counted."""


class FewVisitors(HttpToolsProtocol):
    """One connection more than `MOST_VISITORS` takes the place of the oldest that asks for nothing.

    A browser whose connection was only kept opens another one.
    """

    began_s: float

    @property
    def asks(self) -> bool:
        """Whether a request of it, headers and all, is being answered."""
        return self.cycle is not None and not self.cycle.response_complete

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        super().connection_made(transport)
        self.began_s = self.loop.time()
        there = [one for one in self.connections if isinstance(one, FewVisitors)]
        if len(there) > MOST_VISITORS:
            oldest = min((one for one in there if not one.asks), key=lambda one: one.began_s)
            oldest.transport.abort()
            self.connections.discard(oldest)
