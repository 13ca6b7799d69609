"""The command `rig camera align`: the live picture and its figures, with exposure and gain at hand."""

from rig.align.aligning import align_camera

__all__ = ["align_camera"]
