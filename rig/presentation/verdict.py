"""Result of one check of preflight or doctor: what was checked, what was found, and the remedy."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass


@dataclass(frozen=True, slots=True)
class Verdict:
    """One line of the table of preflight or doctor.

    Attributes
    ----------
    ok
        Whether a measurement is possible. A result that is ok and has a remedy is a warning.
    reason
        What was found, or the reason of a failure; empty if `measured` is sufficient.
    remedy
        What to do; empty if nothing is to be done.
    measured, limit
        Value and limit of a measurement, with units.
    made
        False if there was nothing to check, for the stated reason; `ok` is then True.
    """

    name: str
    ok: bool
    reason: str = ""
    remedy: str = ""
    measured: str = ""
    limit: str = ""
    made: bool = True

    @property
    def line(self) -> str:
        """The verdict in one line: `beam quality: go, one Gaussian, ...`, with reason and remedy."""
        return f"{self.name}: {self.said}"

    @property
    def said(self) -> str:
        """The line without its name."""
        judged = (
            "NO-GO" if not self.ok else "caution" if self.remedy else "go" if self.made else "not checked"
        )
        why = "; ".join(text for text in (self.reason, self.remedy) if text)
        return f"{judged}, {self.measured}" + (f": {why}" if why else "")


def failures(verdicts: Sequence[Verdict]) -> str:
    """The failed checks in one line; empty if all passed."""
    bad = [f"{v.name}: {v.measured} (limit {v.limit}); {v.remedy}" for v in verdicts if not v.ok]
    return "; ".join(bad)


def table_tree(verdicts: Sequence[Verdict]) -> list[dict[str, object]]:
    """The results as plain values, for JSON."""
    return [asdict(verdict) for verdict in verdicts]
