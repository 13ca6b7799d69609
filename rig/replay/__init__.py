"""The command `rig replay`: processes a record again and compares the results with the recorded ones."""

from rig.replay.record_replay import replay_record

__all__ = ["replay_record"]
