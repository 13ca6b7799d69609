"""``python -m tests.validation [--quick] [--again] [--page] [NAME...]``: measure rows, write the page."""

import argparse
import os
import sys
import time
from collections.abc import Sequence

from tests.orphans import leave_no_orphans
from tests.signals import heed_signals
from tests.validation import figure, page
from tests.validation.catalogue import NOT_TESTED, ROWS, SPEED
from tests.validation.kept import kept_now, program_commit, read_kept, write_kept
from tests.validation.row import Missing, Row


def chosen(words: Sequence[str], *, quick: bool) -> list[Row]:
    """The rows that are meant; raises ValueError for a word that means none."""
    for word in words:
        if not any(row.is_meant_by(word) for row in ROWS):
            beginnings = sorted({row.name.partition("-")[0] for row in ROWS})
            raise ValueError(f"no row {word}; rows begin with {', '.join(beginnings)}")
    return [
        row
        for row in ROWS
        if (not words or any(row.is_meant_by(word) for word in words)) and (row.quick or not quick)
    ]


def write_outputs() -> None:
    """The page and its figure, from what is kept."""
    kept = read_kept()
    page.write_page(page.page_of(ROWS, kept, NOT_TESTED))
    figure.FILE.write_bytes(figure.coverage_svg(ROWS, kept))


def main() -> int:
    """Each row is kept as soon as it is measured, so that a run that is ended goes on where it was."""
    parser = argparse.ArgumentParser(prog="python -m tests.validation", description=__doc__)
    parser.add_argument("names", nargs="*", metavar="NAME", help="rows, or beginnings of their names")
    parser.add_argument("--quick", action="store_true", help="rows that take seconds")
    parser.add_argument("--again", action="store_true", help="also rows that this commit has a number of")
    parser.add_argument("--page", action="store_true", help="write the page alone, measure nothing")
    words = parser.parse_args()
    try:
        rows = [] if words.page else chosen(words.names, quick=words.quick)
    except ValueError as error:
        parser.error(str(error))
    leave_no_orphans()
    heed_signals()
    short = 0
    for row in rows:
        kept = read_kept()
        if not words.again and row.name in kept and kept[row.name].commit == program_commit():
            continue
        print(f"{row.name}: {row.claim}", flush=True)
        began_s = time.process_time() + _of_children_s()
        try:
            found = row.measure()[row.number]
        except Missing as missing:
            print(f"  not measured: {missing}", flush=True)
            continue
        except Exception as error:
            # hours of other rows must not be lost with it; what was kept of it before stays
            short += 1
            print(f"  failed: {type(error).__name__}: {error}", flush=True)
            continue
        if row.group == SPEED:
            # a speed that was measured beside other programs is not that of a quiet machine
            said = f"{found.detail}; " if found.detail else ""
            found = found._replace(detail=f"{said}load {os.getloadavg()[0]:.0f}")
        now = kept_now(found, time.process_time() + _of_children_s() - began_s)
        # another program may have kept a row in the meantime
        write_kept({**read_kept(), row.name: now})
        short += not row.limit.holds(now.values)
        print(f"  {page.shown(row, now)} ({row.limit.text}); {now.detail}; {now.cpu_s:g} s", flush=True)
        write_outputs()
    write_outputs()
    print(page.summary(ROWS, read_kept()))
    return 1 if short else 0


def _of_children_s() -> float:
    """Processor time of processes that have ended."""
    times = os.times()
    return times.children_user + times.children_system


if __name__ == "__main__":
    sys.exit(main())
