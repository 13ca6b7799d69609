"""Tables as other programs write them: understood right, refused, rows left out counted, and nothing else."""

import tempfile
from collections import Counter
from pathlib import Path
from typing import Any

from tests.rig.intake.table_cases import judged, table_matrix


def run(quick: bool = False) -> dict[str, Any]:
    """How often which; `quick` takes every fifth table."""
    counts: Counter[str] = Counter()
    wrong = []
    for case in table_matrix()[:: 5 if quick else 1]:
        with tempfile.TemporaryDirectory() as folder:
            outcome = judged(case, Path(folder))
        counts[outcome.kind] += 1
        if outcome.kind == "wrong":
            wrong.append(f"{case.name}: {outcome.said[-120:]}")
    return {"tables": counts.total(), **counts, "wrong": counts["wrong"], "wrong ones": wrong}
