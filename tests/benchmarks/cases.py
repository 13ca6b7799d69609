"""Benchmarks of cases, each for a number of seeds: run all, or those whose names are told in part."""

from collections.abc import Callable, Iterable
from typing import TypeVar

Named = TypeVar("Named")


def chosen(cases: Iterable[Named], words: tuple[str, ...], name: Callable[[Named], str]) -> list[Named]:
    """The cases whose names hold one of the words; all without words."""
    return [case for case in cases if not words or any(word in name(case) for word in words)]
