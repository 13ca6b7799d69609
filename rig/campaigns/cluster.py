"""A campaign's work in parts on a Dask cluster."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any, TypeVar

from processing.campaign import InParts
from processing.errors import ConfigurationError

T = TypeVar("T")
_PATIENCE_S = 10


@contextmanager
def parts_on_cluster(address: str) -> Iterator[InParts]:
    """Work is done by the workers of a cluster that runs already, and runs the same code.

    Raises ConfigurationError where no scheduler answers, no worker is there, or one runs other code.
    """
    from rig.archive import client_of
    from rig.instrument import code_identity

    with client_of(address) as client:
        try:
            client.wait_for_workers(1, timeout=_PATIENCE_S)
        except TimeoutError:
            raise ConfigurationError(
                f"--cluster {address}: it has no worker; dask worker {address} adds one"
            ) from None
        codes = client.run(code_identity)
        other = next((worker for worker, code in codes.items() if code != code_identity()), None)
        if other is not None:
            raise ConfigurationError(
                f"--cluster {address}: {other} runs other code ({codes[other]}) than this program "
                f"({code_identity()})"
            )
        # the design is the large part of the work, and the same in many calls
        sent: list[tuple[Any, Any]] = []

        def do(work: Callable[..., T], design: Any, parts: Sequence[tuple[Any, ...]]) -> list[T]:
            if not sent or sent[0][0] is not design:
                sent[:] = [(design, client.scatter([design], broadcast=True)[0])]
            there = sent[0][1]
            futures = [client.submit(work, there, *part, pure=False) for part in parts]
            return list(client.gather(futures))

        yield do
