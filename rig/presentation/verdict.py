"""Go or no-go, one line each: what was checked, what was found, the remedy."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass


@dataclass(frozen=True, slots=True)
class Verdict:
    """One line of the table of preflight or doctor.

    Attributes
    ----------
    ok
        Nothing stands against a measurement. One that is ok and has a remedy is a warning.
    reason
        What was found, or why it is not well; empty where `measured` says it all.
    remedy
        What to do; empty where nothing is to be done.
    measured, limit
        Of a measurement, with units.
    made
        False: there was nothing to check, for the reason given; that is ok.
    """

    name: str
    ok: bool
    reason: str = ""
    remedy: str = ""
    measured: str = ""
    limit: str = ""
    made: bool = True


def failures(verdicts: Sequence[Verdict]) -> str:
    """The failed checks in one line; empty if all passed."""
    bad = [f"{v.name}: {v.measured} (limit {v.limit}); {v.remedy}" for v in verdicts if not v.ok]
    return "; ".join(bad)


def table_tree(verdicts: Sequence[Verdict]) -> list[dict[str, object]]:
    """The table as plain values."""
    return [asdict(verdict) for verdict in verdicts]
