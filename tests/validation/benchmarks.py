"""Measurements by the benchmarks: one run of a benchmark serves all rows that name a number of it."""

import contextlib
import importlib
import importlib.util
import sys
from collections.abc import Iterator
from functools import cache, partial
from numbers import Real
from typing import Any

from tests.validation.row import Found, Measurement, Missing

PACKAGES = {"nexus": ("nexusformat", ".[bench]"), "spot_beams": ("cv2", ".")}
"""What a benchmark cannot do without, and where pip finds it."""


@cache
def _ran(name: str, part: str = "", argument: int = False, seeds: int = 0, only: tuple[str, ...] = ()) -> Any:
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


def _measured(
    name: str,
    part: str,
    argument: int,
    seeds: int,
    keys: tuple[str, ...],
    only: tuple[str, ...],
    factor: float,
) -> dict[str, Found]:
    found = _ran(name, part, argument, seeds, only)
    values = tuple(factor * value for key in keys for value in numbers_at(found, key))
    if not values:
        raise Missing(f"the benchmark {name} gave no {', '.join(keys)} here: {_why(found)}")
    return {"number": Found(values, _seeds(found))}


def _why(found: Any) -> str:
    """What a benchmark says of what it could not measure."""
    said = [
        str(value)
        for key, value in (found.items() if isinstance(found, dict) else ())
        if "not measured" in key or key == "skipped"
    ]
    return "; ".join(said) or "no reason is stated"


def _seeds(found: Any) -> str:
    counts = sorted({round(count) for count in numbers_at(found, "seeds")})
    return f"{' to '.join(str(count) for count in {counts[0]: 0, counts[-1]: 0})} seeds" if counts else ""


def benchmark(
    name: str,
    *keys: str,
    part: str = "",
    argument: int = False,
    seeds: int = 0,
    only: tuple[str, ...] = (),
    factor: float = 1.0,
) -> Measurement:
    """Numbers of `tests.benchmarks.bench_NAME`: all that its results have at `keys`.

    `part` names a function of it that is called in place of all, with `argument`, ``quick`` by default;
    `seeds` is how many of each case are taken, where it is not the benchmark's own number; `only` are words
    of names of cases, of which all are meant without them.
    """
    return partial(_measured, name, part, argument, seeds, keys, only, factor)


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


def _pooled(name: str, key: str, seeds: int, only: tuple[str, ...]) -> dict[str, Found]:
    shares, counts = pooled_shares(_ran(name, seeds=seeds, only=only)["cases"], key)
    number = f"{counts[0]}" if min(counts) == max(counts) else f"{min(counts)} to {max(counts)}"
    detail = f"{len(counts)} cases of {number} seeds, together {sum(counts)}"
    return {"number": Found(tuple(100.0 * share for share in shares.values()), detail)}


def pooled(name: str, key: str, *, seeds: int, only: tuple[str, ...] = ()) -> Measurement:
    """Shares in per cent of all cases together, by parameter: with few seeds of each, one says little.

    `only` are words of names of cases; without them all are meant.
    """
    return partial(_pooled, name, key, seeds, only)


def peers() -> dict[str, Found]:
    """Other programs on the same windows: their time and their scatter over this tracker's."""
    found = _ran("spot_speed", "peers")
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
