"""The wizard that checks a lever in use against known tilts, before and after a series."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from calibration import read_calibration
from rig.calibrate import Filing, check_known_angle
from rig.wizards.calibration import write_table
from rig.wizards.lever import ladder_questions, ladder_table
from rig.wizards.question import Question


@dataclass(frozen=True)
class CheckWizard:
    """`rig calibrate check`, asked; `lever` is suggested, the one in use where a configuration is at hand."""

    lever: Path | None = None
    kind: str = "check"
    title: str = "Check of the lever against known tilts"

    def questions(self, values: Mapping[str, Any]) -> Iterator[Question]:
        """See `Wizard`."""
        yield Question(
            "lever",
            "Calibration file of the lever to be checked:",
            _lever_file,
            suggested=None if self.lever is None else str(self.lever),
        )
        yield from ladder_questions(values, "tilt")

    def file(self, values: Mapping[str, Any], filing: Filing) -> Path:
        """See `CalibrationWizard`."""
        ladder = write_table(filing.folder, "check-ladder", ladder_table(values, "tilt"))
        return check_known_angle(ladder, values["lever"], filing)


def _lever_file(text: str) -> Path:
    path = Path(text).expanduser()
    read_calibration(path, "lever")
    return path
