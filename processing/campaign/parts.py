"""Work on a campaign's density that is done in parts, which need nothing of each other."""

from collections.abc import Callable, Sequence
from typing import Any, Protocol, TypeVar

from processing.campaign.design import Design

T = TypeVar("T")


class InParts(Protocol):
    """Does the work of every part, wherever it likes; results come in the order of the parts."""

    def __call__(self, work: Callable[..., T], design: Design, parts: Sequence[tuple[Any, ...]]) -> list[T]:
        """Results of ``work(design, *part)``."""


def here(work: Callable[..., T], design: Design, parts: Sequence[tuple[Any, ...]]) -> list[T]:
    """One part after the other, in this process."""
    return [work(design, *part) for part in parts]
