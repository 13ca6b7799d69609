"""Numbers of earlier measurements: what docs/benchmarks.md says, by the first cell of its line."""

import re
from pathlib import Path

BENCHMARKS = Path(__file__).resolve().parents[2] / "docs" / "benchmarks.md"


def known_numbers() -> dict[str, str]:
    """The second cell of each line, its bold type kept, by the first."""
    lines = re.findall(r"^\| ([^|]+) \| ([^|]+) \|$", BENCHMARKS.read_text(encoding="utf-8"), re.MULTILINE)
    return {first.strip(): second.strip() for first, second in lines}


def known_number(beginning: str) -> str:
    """What is known of a row; raises KeyError where no line begins like that, or several do."""
    found = [number for first, number in known_numbers().items() if first.startswith(beginning)]
    if len(found) != 1:
        raise KeyError(f"docs/benchmarks.md has {len(found)} lines that begin with {beginning!r}")
    return found[0]
