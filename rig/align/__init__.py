"""The command `rig camera align`: the live picture and its figures, with exposure and gain at hand."""

from rig.align.aligning import align_camera
from rig.align.annotated_picture import annotated_picture
from rig.align.look import AlignmentFrame, SeenReference, middle_of, take_look
