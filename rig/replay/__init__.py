"""Processes a record again: for `rig replay`, which compares it with what was recorded, or to fit it."""

from rig.replay.comparison import parameter_changes
from rig.replay.record_replay import analyse_replayed, replay_record
