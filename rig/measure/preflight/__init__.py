"""The preflight: checks that decide go or no-go; `PhasesBeforeRecord` makes them before a run."""

from rig.measure.preflight import frame_checks, rest_checks
from rig.measure.preflight.rest_checks import TrialFrames
