"""`rig replay`: a record through the same pipeline again, compared with what was recorded."""

from rig.replay.record_replay import replay_record

__all__ = ["replay_record"]
