"""Benchmarks of cases, each for a number of seeds; and how what any benchmark found is printed."""

from collections.abc import Callable, Iterable, Mapping
from typing import Any, Protocol, TypeVar

from processing.errors import RigError


class Named(Protocol):
    """A case has a name."""

    @property
    def name(self) -> str: ...


CaseT = TypeVar("CaseT", bound=Named)
FoundT = TypeVar("FoundT")

SEEDS_APART = 1000
"""No two cases of a group share a seed: their seeds count together."""


class RunOfCases(Protocol):
    """A benchmark's `run`: quickly, or for so many seeds of each case; `only`: words of their names."""

    def __call__(self, quick: bool = False, seeds: int = 0, only: tuple[str, ...] = ()) -> dict[str, Any]: ...


def run_of(
    measure: Callable[[CaseT, int, int], dict[str, Any]],
    *groups: Callable[[], Iterable[CaseT]],
    seeds: int,
    quick_seeds: int,
    apart: int = SEEDS_APART,
) -> RunOfCases:
    """What `measure(case, seeds, first seed)` finds of each case; 0 seeds apart, cases share their noise."""
    usual = seeds

    def run(quick: bool = False, seeds: int = 0, only: tuple[str, ...] = ()) -> dict[str, Any]:
        found = []
        for cases in groups:
            for number, case in enumerate(cases()):
                if not only or any(word in case.name for word in only):
                    each = quick_seeds if quick else seeds or usual
                    found.append({"case": case.name} | measure(case, each, apart * number))
                    show(found[-1])
        return {"cases": found}

    return run


def each_seed(one: Callable[[int], FoundT], seeds: int, first: int = 0) -> tuple[list[FoundT], int]:
    """What is found for each seed, and for how many the program refused to find something."""
    found = []
    for seed in range(first, first + seeds):
        try:
            found.append(one(seed))
        except RigError as error:
            print(f"  seed {seed}: {error}")
    return found, seeds - len(found)


def show(results: Any, indent: str = "  ") -> None:
    """Print nested results: an entry without further ones in a line, the others below their names."""
    for key, value in results.items() if isinstance(results, Mapping) else enumerate(results):
        inner = list(value.values()) if isinstance(value, Mapping) else value
        if isinstance(inner, list) and any(isinstance(each, Mapping | list) for each in inner):
            print(f"{indent}{key}:")
            show(value, indent + "  ")
        elif isinstance(value, Mapping):
            print(f"{indent}{key}: " + ", ".join(f"{name} {_text(each)}" for name, each in value.items()))
        else:
            print(f"{indent}{key}: " + ", ".join(map(_text, value if isinstance(value, list) else [value])))


def _text(value: Any) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)
