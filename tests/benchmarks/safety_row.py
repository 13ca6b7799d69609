"""A row of the table of faults."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Row:
    """What came of a fault; times in s, None where there is nothing to measure.

    `dark_s` is from the fault to the dark on the board's clock, `says_on_s` how long the program said "on"
    after it, `relit` how often light came that nobody asked for, `needed` what light took afterwards.
    """

    path: str
    fault: str
    dark_s: float | None
    says: str
    says_on_s: float | None
    relit: int
    needed: str
    violation: str = ""

    @property
    def line(self) -> str:
        """Of a table in Markdown."""
        dark = "–" if self.dark_s is None else f"{self.dark_s:.2f}"
        on = "–" if self.says_on_s is None else f"{self.says_on_s:.1f}"
        wrong = f" **{self.violation}**" if self.violation else ""
        return f"| {self.path} | {self.fault} | {dark} | {self.says} | {on} | {self.needed}{wrong} |"
