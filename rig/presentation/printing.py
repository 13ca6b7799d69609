"""Output on the terminal: lines for the user, and JSON lines for programs."""

import json
import math
import sys
from collections.abc import Mapping
from typing import Any


def say(text: str, *, error: bool = False) -> None:
    """Print one line on stderr, because programs read stdout."""
    print(f"rig: {text}" if error else text, file=sys.stderr, flush=True)


def print_json_line(kind: str, values: Mapping[str, Any]) -> None:
    """Print one JSON object on one line of stdout; NaN and infinity become null."""
    print(json.dumps({"kind": kind, **plain_values(values)}), flush=True)


def plain_values(value: Any) -> Any:
    """Nested values for JSON, where NaN and infinity become null (not determined)."""
    if isinstance(value, Mapping):
        return {str(key): plain_values(inner) for key, inner in value.items()}
    if isinstance(value, list | tuple):
        return [plain_values(inner) for inner in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
