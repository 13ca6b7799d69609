"""Inputs of others: films and tables are right, refused, or losses counted; wrong words are refused."""

import logging
import tempfile
from collections import Counter
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from tests.acquisition.cameras import film_cases
from tests.rig.commands.test_wrong_inputs import faults_of_key, faults_of_words
from tests.rig.commands.wrong_inputs import wrong_keys, wrong_words
from tests.rig.intake import table_cases


def _judged(cases: Sequence[Any], judged: Callable[[Any, Path], Any], quick: bool) -> dict[str, Any]:
    """How often which; `quick` takes every fifth."""
    counts: Counter[str] = Counter()
    wrong = []
    for case in cases[:: 5 if quick else 1]:
        with tempfile.TemporaryDirectory() as folder:
            try:
                outcome = judged(case, Path(folder))
            except (ValueError, OSError):
                counts["not made"] += 1
                continue
        counts[outcome.kind] += 1
        if outcome.kind == "wrong":
            wrong.append(f"{case.name}: {outcome.said[-120:]}")
    return {"cases": counts.total(), **counts, "wrong": counts["wrong"], "wrong ones": wrong}


def films(quick: bool = False) -> dict[str, Any]:
    """Of every container, codec, pixel format, clock, damage."""
    logging.disable(logging.WARNING)
    return _judged(film_cases.matrix(), film_cases.judged, quick)


def tables(quick: bool = False) -> dict[str, Any]:
    """As other programs write them; one that cannot be made is a fault of the test."""
    found = _judged(table_cases.table_matrix(), table_cases.judged, quick)
    return found | {"wrong": found["wrong"] + found.get("not made", 0)}


def wrong_inputs(quick: bool = False) -> dict[str, Any]:
    """All that follow from models and commands; how many were taken, or answered in another way."""
    keys = list(wrong_keys())[:: 5 if quick else 1]
    with tempfile.TemporaryDirectory() as name:
        words = list(wrong_words(Path(name)))[:: 5 if quick else 1]
        faults = [fault for each in keys for fault in faults_of_key(each)]
        faults += [fault for each in words for fault in faults_of_words(each, Path(name))]
    return {"keys": len(keys), "calls": len(words), "faults": len(faults), "not refused": faults}


def run(quick: bool = False) -> dict[str, Any]:
    """All of them; of what is wrong there must be 0."""
    return {part.__name__: part(quick) for part in (films, tables, wrong_inputs)}
