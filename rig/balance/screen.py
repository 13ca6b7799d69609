"""The output of `rig balance`: every quantity before and after a turn, and the advice."""

import math
from collections.abc import Sequence

from rich.console import Console
from rich.table import Table

from processing.balance import Fault, Turn, Unreachable
from rig.instrument import turn_text
from rig.presentation import NOT_KNOWN, say, with_uncertainty


def print_faults(faults: Sequence[Fault], before: Sequence[Fault], *, live: bool = False) -> None:
    """Print a table of the balance; with `live` one line on stderr."""
    if live:
        parts = [f"{f.name} {f.value:+.3g} {f.unit}".rstrip() for f in faults[:2] if math.isfinite(f.value)]
        say("  ".join(parts))
        return
    table = Table(box=None, pad_edge=False, header_style="bold")
    for name in ("", "number", "now"):
        table.add_column(name)
    if before:
        table.add_column("before")
    for name in ("limit", "what it means"):
        table.add_column(name)
    for k, fault in enumerate(faults):
        row = ["go" if fault.ok else "NO", fault.name, _number(fault)]
        if before:
            row.append(_number(before[k]))
        table.add_row(*row, f"{fault.limit:g} {fault.unit}".rstrip(), "" if fault.ok else fault.meaning)
    Console().print(table, highlight=False)


def _number(fault: Fault) -> str:
    if math.isnan(fault.value):
        return NOT_KNOWN
    return f"{with_uncertainty(fault.value, fault.u_value, signed=True)} {fault.unit}".rstrip()


def print_advice(turn: Turn | Unreachable | None, faults: Sequence[Fault]) -> None:
    """Print which weight to turn, by how much and in which direction."""
    Console().print(turn_text(turn, faults), highlight=False, markup=False, soft_wrap=True)
