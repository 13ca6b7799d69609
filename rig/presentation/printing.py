"""What a person at the terminal is told: lines, tables, and JSON lines for programs."""

import json
import math
import sys
from collections.abc import Mapping
from typing import Any

from rich.console import Console
from rich.table import Table

DISPLAY = {
    "b": ("b", "rad^-p", 1.0),
    "p": ("p", "", 1.0),
    "c": ("c", "", 1.0),
    "n": ("n", "", 1.0),
    "period0_s": ("T0", "s", 1.0),
    "gamma_pa": ("gamma", "MPa", 1e-6),
}
"""How a parameter is printed: symbol, unit, and the factor to that unit."""


def say(text: str, *, error: bool = False) -> None:
    """One line on stderr, where it does not mix with what a program reads from stdout."""
    print(f"rig: {text}" if error else text, file=sys.stderr, flush=True)


def print_json_line(kind: str, values: Mapping[str, Any]) -> None:
    """One JSON object on one line of stdout; what is not a number is null."""
    print(json.dumps({"kind": kind, **plain_values(values)}), flush=True)


def value_with_uncertainty(estimate: tuple[float, float], scale: float = 1.0) -> str:
    """Value and standard uncertainty, to two digits of the uncertainty: ``(3.7330 ± 0.0012)e-03``."""
    value, u = estimate[0] * scale, estimate[1] * scale
    if not math.isfinite(value):
        return "not determined"
    if not math.isfinite(u) or u <= 0:
        return f"{value:.6g} ± ?"
    exponent = math.floor(math.log10(max(abs(value), u)))
    shift = 0 if -3 <= exponent <= 4 else exponent
    digits = max(0, 1 - math.floor(math.log10(u / 10.0**shift)))
    text = f"{value / 10.0**shift:.{digits}f} ± {u / 10.0**shift:.{digits}f}"
    return f"({text})e{shift:+03d}" if shift else text


def print_table(table: Table) -> None:
    """A table on stdout."""
    Console().print(table)


def plain_values(value: Any) -> Any:
    """Nested values for JSON, where NaN and infinity become null, which says "not determined"."""
    if isinstance(value, Mapping):
        return {str(key): plain_values(inner) for key, inner in value.items()}
    if isinstance(value, list | tuple):
        return [plain_values(inner) for inner in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
