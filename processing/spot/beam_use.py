"""Which model of the beam a run used, since when, and how many of its spots have which flag."""

import numpy as np
from numpy.typing import ArrayLike

from processing.arrays import Ints
from processing.spot.model_choice import LONGEST_CHOICE_FRAMES, SpotModel
from processing.spot.spot import SpotFlag

_ANOTHER_FRAMES = 64
"""Fewer frames in a row with another model are frames that the chosen one missed: a choice takes longer."""

_FLAGS, _MODELS = tuple(SpotFlag), tuple(SpotModel)
_BITS = np.array(_FLAGS, dtype=np.int64)


class BeamUse:
    """Counts the spots of a run as they pass, some frames at a time.

    The spots before the first choice of a learned profile fit badly because it is not there yet: they are
    counted with their flags, but not judged.

    Attributes
    ----------
    frames
        How many have passed.
    flags
        Number of spots with each flag.
    model, since_frame
        The model in use, and the number of the first frame fitted with it; None and -1 without a spot.
    changes
        How many times the beam got another model after its first choice.
    choosing_frames
        Spots before a profile was learned for the first time; 0 if none was.
    judged_frames, poor_frames
        Spots since then, and how many of them have the flag POOR_FIT.
    poor_with
        How many of the latter also have each other flag.
    """

    def __init__(self) -> None:
        self.frames = 0
        self.flags = dict.fromkeys(SpotFlag, 0)
        self.model: SpotModel | None = None
        self.since_frame = -1
        self.changes = 0
        self.choosing_frames = 0
        self.judged_frames = 0
        self.poor_frames = 0
        self.poor_with = dict.fromkeys(SpotFlag, 0)
        self._found = 0
        self._learned = False
        self._other: SpotModel | None = None
        self._other_since = -1
        self._others = 0

    @property
    def text(self) -> str:
        """`learned profile since frame 147`, or that there is no spot."""
        return "no spot" if self.model is None else f"{self.model} since frame {self.since_frame}"

    def take(self, sequences: ArrayLike, flags: ArrayLike) -> None:
        """Numbers and flags of the next frames, arrays of one length."""
        numbers, marks = np.asarray(sequences, dtype=np.int64), np.asarray(flags, dtype=np.int64)
        self.frames += len(marks)
        _count(self.flags, marks)
        found = (marks & SpotFlag.LOST) == 0
        numbers, marks = numbers[found], marks[found]
        models = np.where(marks & SpotFlag.LEARNED, 2, np.where(marks & SpotFlag.MULTIPLE, 1, 0))
        starts = np.flatnonzero(np.diff(models, prepend=-1))
        for start, count in zip(starts.tolist(), np.diff(starts, append=len(models)).tolist(), strict=True):
            self._stretch(_MODELS[models[start]], int(numbers[start]), marks[start : start + count])

    def _stretch(self, model: SpotModel, number: int, marks: Ints) -> None:
        """Some spots in a row that were fitted with the same model."""
        first_learned = model is SpotModel.LEARNED and not self._learned
        if first_learned:
            self._learned = True
            if self._found <= LONGEST_CHOICE_FRAMES:
                self.choosing_frames = self._found
                self.judged_frames = self.poor_frames = 0
                self.poor_with = dict.fromkeys(SpotFlag, 0)
        self._judge(marks)
        if self.model is None:
            self.model, self.since_frame = model, number
        elif model is self.model:
            self._others = 0
        else:
            if model is not self._other or not self._others:
                self._other, self._other_since, self._others = model, number, 0
            self._others += len(marks)
            if first_learned or self._others >= _ANOTHER_FRAMES:
                self.model, self.since_frame, self._others = model, self._other_since, 0
                self.changes += self._found > LONGEST_CHOICE_FRAMES
        self._found += len(marks)

    def _judge(self, marks: Ints) -> None:
        self.judged_frames += len(marks)
        poor = marks[(marks & SpotFlag.POOR_FIT) != 0]
        self.poor_frames += len(poor)
        _count(self.poor_with, poor)


def _count(flags: dict[SpotFlag, int], marks: Ints) -> None:
    """Add how many of the spots have each flag."""
    if len(marks):
        found = np.count_nonzero(marks[:, None] & _BITS, axis=0)
        for flag, count in zip(_FLAGS, found.tolist(), strict=True):
            flags[flag] += count
