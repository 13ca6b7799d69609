"""Go or no-go, one line each: what was checked, the reason, the remedy."""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Verdict:
    """One line of the table. `made` False: there was nothing to check, which is ok and has its reason.

    One that is ok and has a remedy all the same is a warning.
    """

    name: str
    measured: str
    limit: str
    ok: bool
    reason: str = ""
    remedy: str = ""
    made: bool = True


@dataclass(frozen=True, slots=True)
class Check:
    """One line of a go / no-go table; `remedy` is empty where all is well.

    One that is ok and has a remedy all the same is a warning.
    """

    name: str
    ok: bool
    reason: str
    remedy: str = ""
