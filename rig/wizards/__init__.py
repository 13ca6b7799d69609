"""Wizards: questions asked one by one, in the terminal or on the operator's page, whose answers become files.

A wizard is a list of questions as plain values (`Question`), each of which may depend on the answers before
it. `Draft` keeps the answers as typed, `progress` reads them and says what is asked next, `answered` takes
one more. `ask_in_terminal` does that at a keyboard. A `CalibrationWizard` then files a calibration by the
function of `rig calibrate`, and `filed` says what to show of it.
"""

from rig.wizards.calibration import (
    CalibrationWizard,
    Filed,
    filed,
    next_free,
    place_for,
    recorder_of,
)
from rig.wizards.configuration_file import copy_shipped, refuse_existing, stated_keys, write_configuration
from rig.wizards.draft import (
    Draft,
    Progress,
    answered,
    as_far_as_it_holds,
    drop_draft,
    keep_draft,
    kept_draft,
    progress,
)
from rig.wizards.first_configuration import FirstConfiguration
from rig.wizards.kinds import KINDS, calibration_wizard
from rig.wizards.question import Choice, Question, RecordedAnswer, Wizard
from rig.wizards.recorded_files import steps_of_file
from rig.wizards.terminal import ask_in_terminal
