"""Films of every container, codec, pixel format, clock, damage: right, refused or counted, no third case."""

import logging
import tempfile
from collections import Counter
from pathlib import Path
from typing import Any

from tests.acquisition.cameras.film_cases import judged, matrix


def run(quick: bool = False) -> dict[str, Any]:
    """How often which; `quick` takes every fifth film."""
    logging.disable(logging.WARNING)
    counts: Counter[str] = Counter()
    wrong = []
    worst_px = 0.0
    for case in matrix()[:: 5 if quick else 1]:
        with tempfile.TemporaryDirectory() as folder:
            try:
                outcome = judged(case, Path(folder))
            except (ValueError, OSError):
                counts["not made"] += 1
                continue
        counts[outcome.kind] += 1
        if outcome.kind == "wrong":
            wrong.append(f"{case.name}: {outcome.said[-100:]}")
        else:
            worst_px = max(worst_px, outcome.worst_px)
    return {
        "films": counts.total(),
        **counts,
        "wrong": counts["wrong"],
        "wrong ones": wrong,
        "worst of the others, px": worst_px,
    }
