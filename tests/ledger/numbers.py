"""Numbers of a results file as flat entries, and the difference between two sets of them."""

import json
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from typing import Any, TypeGuard

Entry = list[Any]
"""``[value]`` or ``[value, u]``; of a long list ``[length, first, last, mean]``; a verdict is a string."""

LONGEST_LIST = 12
DIGITS = 10
"""Significant digits that are kept; equal means equal in all but the last two."""

VALUE_LIMIT_U = 0.05
"""A value may move by this part of its standard uncertainty where numbers may move at all."""
U_LIMIT = 0.02
"""And the uncertainty itself by this part of it; so may a number that has none."""
DRAWN_U_LIMIT = 0.1
"""The same of an uncertainty from draws: their seed is the record's hash, which changes from run to run."""

NOT_KEPT = (
    *("*_bytes", "*/started*", "*/software/*", "/schema", "*sha256*", "*elapsed*", "*/provenance/*"),
    *("*/frames", "*/judged_frames"),
)
"""Paths of what is no result (sizes of files, moments, versions), and of what differs from run to run: draws,
and how many frames came after the end was noticed."""
DRAWN = ("*/work_per_cycle/*",)
WORDS_KEPT = ("*/verdict", "*/name", "*/quantity")


def entries(results: Any) -> dict[str, Entry]:
    """Every number of a results file by its path, with its standard uncertainty where it has one."""
    return {
        path: entry for path, entry in _walk(results, "") if not any(fnmatchcase(path, p) for p in NOT_KEPT)
    }


def _walk(value: Any, path: str) -> Iterator[tuple[str, Entry]]:
    if isinstance(value, dict):
        if "value" in value and "standard_uncertainty" in value and _is_number(value["value"]):
            yield path, [_rounded(value["value"]), _rounded(value["standard_uncertainty"])]
            value = {k: v for k, v in value.items() if k not in ("value", "standard_uncertainty")}
        for key, inner in value.items():
            yield from _walk(inner, f"{path}/{key}")
    elif isinstance(value, list):
        numbers = _flat(value)
        if len(numbers) > LONGEST_LIST:
            finite = [number for number in numbers if math.isfinite(number)]
            mean = math.fsum(finite) / len(finite) if finite else math.nan
            yield path, [len(numbers), *(_rounded(x) for x in (numbers[0], numbers[-1], mean))]
        else:
            for index, inner in enumerate(value):
                yield from _walk(inner, f"{path}/{index}")
    elif _is_number(value):
        yield path, [_rounded(value)]
    elif isinstance(value, str) and any(fnmatchcase(path, kept) for kept in WORDS_KEPT):
        yield path, [value]


def _flat(values: list[Any]) -> list[float]:
    """The numbers of a list, or of a list of lists; empty where it holds anything else. None is NaN."""
    found: list[float] = []
    for value in values:
        inner = _flat(value) if isinstance(value, list) else [math.nan if value is None else value]
        if not inner or not all(map(_is_number, inner)):
            return []
        found += map(float, inner)
    return found


def _is_number(value: object) -> TypeGuard[float]:
    return isinstance(value, int | float)


def _rounded(value: Any) -> Any:
    return float(f"{value:.{DIGITS - 1}e}") if isinstance(value, float) and math.isfinite(value) else value


@dataclass(frozen=True)
class Difference:
    """An entry of one case that is not what it was."""

    case: str
    path: str
    kind: str
    """``gone``, ``new``, ``within`` the limits, or ``moved`` beyond them."""
    before: Entry | None
    after: Entry | None

    def __str__(self) -> str:
        return f"{self.case} {self.path}: {self.kind}: {json.dumps(self.before)} -> {json.dumps(self.after)}"


def differences(case: str, before: Mapping[str, Entry], after: Mapping[str, Entry]) -> Sequence[Difference]:
    """What is gone, new or different, in the order of the paths."""
    found = []
    for path in sorted({*before, *after}):
        old, new = before.get(path), after.get(path)
        if old is None or new is None:
            found.append(Difference(case, path, "new" if old is None else "gone", old, new))
        elif not _equal(old, new):
            found.append(Difference(case, path, "within" if _within(path, old, new) else "moved", old, new))
    return found


def _equal(old: Entry, new: Entry) -> bool:
    return len(old) == len(new) and all(map(_same, old, new))


def _same(a: Any, b: Any) -> bool:
    if not (_is_number(a) and _is_number(b)):
        return bool(a == b)
    both_nan = math.isnan(a) and math.isnan(b)
    return both_nan or math.isclose(a, b, rel_tol=10.0 ** (2 - DIGITS), abs_tol=1e-300)


def _within(path: str, old: Entry, new: Entry) -> bool:
    """Whether an entry moved within the limits."""
    if len(old) != len(new) or not all(_is_number(x) and math.isfinite(x) for x in (*old, *new)):
        return False
    limits = [U_LIMIT * abs(value) for value in old]
    if len(old) == 2:
        drawn = any(fnmatchcase(path, pattern) for pattern in DRAWN)
        limits = [VALUE_LIMIT_U * old[1], (DRAWN_U_LIMIT if drawn else U_LIMIT) * old[1]]
    return all(abs(b - a) <= limit for a, b, limit in zip(old, new, limits, strict=True))
