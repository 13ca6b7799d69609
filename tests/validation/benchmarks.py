"""Measurements by the benchmarks: one run of a benchmark serves all rows that name a number of it."""

import contextlib
import importlib
import importlib.util
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from numbers import Real
from typing import Any

from tests.validation.row import Found, Missing

PACKAGES = {"nexus": ("nexusformat", ".[bench]"), "spot_beams": ("cv2", ".")}
"""What a benchmark cannot do without, and where pip finds it."""


@cache
def _ran(name: str, part: str, argument: int, seeds: int, only: tuple[str, ...]) -> Any:
    module, place = PACKAGES.get(name, ("numpy", "."))
    if importlib.util.find_spec(module) is None:
        raise Missing(f'{module}: pip install "{place}"')
    benchmark = importlib.import_module(f"tests.benchmarks.bench_{name}")
    # tables of a benchmark are for its own reader; what is printed here is the rows
    with contextlib.redirect_stdout(sys.stderr):
        if part:
            return getattr(benchmark, part)(argument)
        chosen = {"seeds": seeds} if seeds else {}
        return benchmark.run(quick=False, **chosen, **({"only": only} if only else {}))


def numbers_at(found: Any, key: str) -> Iterator[float]:
    """All numbers below any entry `key` of nested results; those of a `key` that is itself a number."""
    if isinstance(found, dict):
        for name, value in found.items():
            if name == key:
                yield from _numbers(value)
            else:
                yield from numbers_at(value, key)
    elif isinstance(found, list | tuple):
        for value in found:
            yield from numbers_at(value, key)


def _numbers(value: Any) -> Iterator[float]:
    if isinstance(value, dict):
        for inner in value.values():
            yield from _numbers(inner)
    elif isinstance(value, list | tuple):
        for inner in value:
            yield from _numbers(inner)
    elif isinstance(value, Real) and not isinstance(value, bool):
        yield float(value)


@dataclass(frozen=True)
class Benchmark:
    """A measurement by `tests.benchmarks.bench_NAME`: all numbers that its results have at `keys`.

    Attributes
    ----------
    part, argument
        A function of it that is called in place of all, with what: ``quick`` by default.
    seeds
        How many of each case are taken, where it is not the benchmark's own number.
    only
        Words of names of cases, of which all are meant without them.
    is_pooled
        Shares of all cases together, by parameter: with few seeds of each, one says little.
    """

    name: str
    keys: tuple[str, ...]
    part: str = ""
    argument: int = False
    seeds: int = 0
    only: tuple[str, ...] = ()
    factor: float = 1.0
    is_pooled: bool = False

    def __call__(self) -> dict[str, Found]:
        found = _ran(self.name, self.part, self.argument, self.seeds, self.only)
        if self.is_pooled:
            return {"number": self._pooled(found["cases"])}
        values = tuple(self.factor * value for key in self.keys for value in numbers_at(found, key))
        if not values:
            raise Missing(f"the benchmark {self.name} gave no {', '.join(self.keys)} here: {_why(found)}")
        counts = sorted({f"{count:.0f}" for count in numbers_at(found, "seeds")}, key=int)
        seeds = f"{' to '.join(dict.fromkeys([counts[0], counts[-1]]))} seeds" if counts else ""
        return {"number": Found(values, seeds)}

    def _pooled(self, cases: Any) -> Found:
        shares, counts = pooled_shares(cases, *self.keys)
        number = " to ".join(str(count) for count in dict.fromkeys([min(counts), max(counts)]))
        detail = f"{len(counts)} cases of {number} seeds, together {sum(counts)}"
        return Found(tuple(self.factor * share for share in shares.values()), detail)


def benchmark(name: str, *keys: str, **how: Any) -> Benchmark:
    """Numbers of a benchmark."""
    return Benchmark(name, keys, **how)


def pooled(name: str, key: str, *, seeds: int, only: tuple[str, ...] = ()) -> Benchmark:
    """Shares in per cent of all cases of a benchmark together, by parameter."""
    return Benchmark(name, (key,), seeds=seeds, only=only, factor=100.0, is_pooled=True)


def _why(found: Any) -> str:
    """What a benchmark says of what it could not measure."""
    said = [
        str(value)
        for key, value in (found.items() if isinstance(found, dict) else ())
        if "not measured" in key or key == "skipped"
    ]
    return "; ".join(said) or "no reason is stated"


def pooled_shares(cases: Any, key: str) -> tuple[dict[str, float], list[int]]:
    """Share of all seeds of all cases that have `key`, by parameter; and how many seeds each case had.

    No two cases of a benchmark share a seed, so that their seeds count together.
    """
    held: dict[str, float] = {}
    counts = []
    for case in cases:
        shares = case[key]
        listed = shares if isinstance(shares, list) else [shares]
        by_name = shares if isinstance(shares, dict) else {str(k): share for k, share in enumerate(listed)}
        done = case["seeds"] - case.get("failed", 0)
        counts.append(done)
        for name, share in by_name.items():
            held[name] = held.get(name, 0.0) + share * done
    return {name: number / sum(counts) for name, number in held.items()}, counts


def peers() -> dict[str, Found]:
    """Other programs on the same windows: their time and their scatter over this tracker's."""
    found = _ran("spot_speed", "peers", False, 0, ())
    own = found["this tracker"]["scatter_mpx"]
    others = {
        name: numbers
        for name, numbers in found.items()
        if "skipped" not in numbers and name not in ("this tracker", "cv2.moments")
    }
    if not others:
        raise Missing('no other program: pip install ".[bench]"')
    skipped = [name for name, numbers in found.items() if "skipped" in numbers]
    left_out = f"; not here: {', '.join(skipped)}" if skipped else ""
    return {
        "scatter": Found(
            tuple(numbers["scatter_mpx"] / own for numbers in others.values()), ", ".join(others) + left_out
        ),
        "slower": Found(
            tuple(numbers["times_slower"] for numbers in others.values()),
            ", ".join(f"{name} {numbers['times_slower']:.0f}" for name, numbers in others.items()) + left_out,
        ),
    }
