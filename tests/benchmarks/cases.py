"""Benchmarks of cases, each for a number of seeds: run all, or those whose names are told in part."""

import argparse
import json
import sys
from collections.abc import Callable, Iterable
from typing import Any, TypeVar

Named = TypeVar("Named")


def chosen(cases: Iterable[Named], words: tuple[str, ...], name: Callable[[Named], str]) -> list[Named]:
    """The cases whose names hold one of the words; all without words."""
    return [case for case in cases if not words or any(word in name(case) for word in words)]


def run_told(
    about: str | None, run: Callable[[bool, int, tuple[str, ...]], dict[str, Any]], seeds: int
) -> None:
    """Run what the command line asks for, and write the numbers to stderr."""
    parser = argparse.ArgumentParser(description=about)
    parser.add_argument("cases", nargs="*", metavar="CASE", help="parts of names of cases; all without")
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--seeds", type=int, default=seeds)
    words = parser.parse_args()
    json.dump(run(words.quick, words.seeds, tuple(words.cases)), sys.stderr, indent=1)
