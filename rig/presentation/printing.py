"""What a person at the terminal is told: lines, tables, and JSON lines for programs."""

import json
import math
import sys
from collections.abc import Mapping
from typing import Any


def say(text: str, *, error: bool = False) -> None:
    """One line on stderr, where it does not mix with what a program reads from stdout."""
    print(f"rig: {text}" if error else text, file=sys.stderr, flush=True)


def print_json_line(kind: str, values: Mapping[str, Any]) -> None:
    """One JSON object on one line of stdout; what is not a number is null."""
    print(json.dumps({"kind": kind, **plain_values(values)}), flush=True)


def plain_values(value: Any) -> Any:
    """Nested values for JSON, where NaN and infinity become null, which says "not determined"."""
    if isinstance(value, Mapping):
        return {str(key): plain_values(inner) for key, inner in value.items()}
    if isinstance(value, list | tuple):
        return [plain_values(inner) for inner in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
