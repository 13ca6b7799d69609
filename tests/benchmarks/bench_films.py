"""Films of every container, codec, pixel format, clock and damage: right, refused, counted, and no third
case.
"""

import logging
import tempfile
from collections import Counter
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from tests.acquisition.cameras.film_cases import judged, matrix


def run(quick: bool = False) -> dict[str, Any]:
    """How often which; `quick` takes every fifth film."""
    logging.disable(logging.WARNING)
    table = Table("film", "outcome", "worst, px", "worst time / span", "said")
    counts: Counter[str] = Counter()
    wrong = []
    worst_px = 0.0
    for case in matrix()[:: 5 if quick else 1]:
        with tempfile.TemporaryDirectory() as folder:
            try:
                outcome = judged(case, Path(folder))
            except (ValueError, OSError) as error:
                table.add_row(case.name, "not made", "", "", str(error)[:80])
                counts["not made"] += 1
                continue
        counts[outcome.kind] += 1
        if outcome.kind == "wrong":
            wrong.append(case.name)
        else:
            worst_px = max(worst_px, outcome.worst_px)
        table.add_row(
            case.name,
            outcome.kind,
            f"{outcome.worst_px:.4f}",
            f"{outcome.worst_time:.1e}",
            outcome.said[-100:],
        )
    Console(width=200).print(table)
    results = {
        "films": sum(counts.values()),
        **counts,
        "wrong": counts["wrong"],
        "wrong ones": wrong,
        "worst of the others, px": worst_px,
    }
    print(results)
    return results
