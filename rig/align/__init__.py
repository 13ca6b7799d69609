"""The command `rig camera align`: the live picture and its figures, with exposure and gain at hand."""

from rig.align.aligning import align_camera
from rig.align.look import AlignmentFrame, SeenReference, annotated_picture, middle_of, take_look
