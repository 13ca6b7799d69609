"""A campaign's work in parts on a Dask cluster."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any, TypeVar

from processing.campaign import InParts

T = TypeVar("T")


@contextmanager
def parts_on_cluster(address: str) -> Iterator[InParts]:
    """Work is done by the workers of a cluster that runs already; raises as `client_of`."""
    from rig.archive import client_of

    with client_of(address) as client:
        # the design is the large part of the work, and the same in many calls
        sent: list[tuple[Any, Any]] = []

        def do(work: Callable[..., T], design: Any, parts: Sequence[tuple[Any, ...]]) -> list[T]:
            if not sent or sent[0][0] is not design:
                sent[:] = [(design, client.scatter([design], broadcast=True)[0])]
            there = sent[0][1]
            futures = [client.submit(work, there, *part, pure=False) for part in parts]
            return list(client.gather(futures))

        yield do
