"""The model of the beam that a run used, its spots' flags, and the verdict on how well it fitted."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from math import nan
from typing import Self

from processing.spot import LONGEST_CHOICE_FRAMES, BeamUse, SpotFlag, SpotModel
from rig.presentation import Verdict, percent

_EASED = SpotFlag.MULTIPLE | SpotFlag.LEARNED
"""Flags that name the model, and are no fault of a spot."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Beam:
    """What the spots of a run reveal about its beam.

    `model` is the model in use at the end, `since_frame` the number of the first frame fitted with it,
    `changes` how often the model changed after the first choice. `flags` are the numbers of spots with each
    flag, without zeros. POOR_FIT is judged on the `judged_frames` spots after `choosing_frames`, from which
    the profile was learned; `poor_fit_frames` of them have it, and `likely_cause` says why.
    """

    model: str = ""
    since_frame: int = -1
    changes: int = 0
    flags: Mapping[str, int] = field(default_factory=dict)
    choosing_frames: int = 0
    judged_frames: int = 0
    poor_fit_frames: int = 0
    poor_fit_fraction: float = nan
    likely_cause: str = ""
    remedy: str = ""

    @classmethod
    def of(cls, use: BeamUse, *, noise_is_known: bool) -> Self:
        """From the flags; `noise_is_known`: the sensor's noise is stated, not assumed."""
        cause, remedy = _cause(use, noise_is_known=noise_is_known) if use.poor_frames else ("", "")
        return cls(
            model=use.model or "",
            since_frame=use.since_frame,
            changes=use.changes,
            flags={flag.name or "": count for flag, count in use.flags.items() if count},
            choosing_frames=use.choosing_frames,
            judged_frames=use.judged_frames,
            poor_fit_frames=use.poor_frames,
            poor_fit_fraction=use.poor_frames / use.judged_frames if use.judged_frames else nan,
            likely_cause=cause,
            remedy=remedy,
        )

    @property
    def sentence(self) -> str:
        """`Beam: learned profile since frame 147; POOR_FIT 147 (before it was learned).`"""
        if not self.model:
            return "Beam: no spot was found."
        flagged = [
            f"{name} {count}"
            + (" (while it was learned)" if name == "POOR_FIT" and self._only_at_first else "")
            for name, count in self.flags.items()
            if not SpotFlag[name] & _EASED
        ]
        changed = f", after {self.changes} changes" if self.changes else ""
        flags = f"spots with {', '.join(flagged)}" if flagged else "no spot is flagged as faulty"
        return f"Beam: {self.model} since frame {self.since_frame}{changed}; {flags}."

    @property
    def _only_at_first(self) -> bool:
        return self.choosing_frames > 0 and not self.poor_fit_frames

    def verdict(self, most: float) -> Verdict:
        """A warning where more than the fraction `most` of the judged spots have the flag POOR_FIT."""
        poor = self.poor_fit_fraction > most
        return Verdict(
            "beam",
            True,
            f"the model does not fit it, and uncertainties are only widened for that: {self.likely_cause}"
            if poor
            else "",
            self.remedy if poor else "",
            measured=f"{self.model or 'no spot'}, POOR_FIT in {self.poor_fit_frames} of {self.judged_frames} "
            f"({percent(self.poor_fit_frames / max(self.judged_frames, 1))})",
            limit=f"{100 * most:g} %",
        )


def _cause(use: BeamUse, *, noise_is_known: bool) -> tuple[str, str]:
    """The most likely reason of POOR_FIT, and its remedy."""
    half = 0.5 * use.poor_frames
    if use.poor_with[SpotFlag.EDGE] > half:
        return "the edge of the sensor cuts the spot", "move the spot to the middle: rig camera align"
    if use.poor_with[SpotFlag.CUT] > half:
        return "something cuts the spot", "centre the beam in lens, mirrors and window; free its path"
    if use.poor_with[SpotFlag.SATURATED] > half:
        return (
            "it is saturated, and only its flanks are fitted",
            "lower the exposure (exposure_us) or the laser's power",
        )
    if use.changes:
        return "it changed during the run", "let the laser warm up; fix the optics; look for what moved"
    if use.model is SpotModel.LEARNED:
        return (
            "it changes with position (something cuts it, dust or fringes on the window) or with time",
            "free the beam's path, clean the window; then rig camera align",
        )
    if use.judged_frames < LONGEST_CHOICE_FRAMES:
        return "the run was too short to learn its profile", "measure longer, or clean the optics"
    if not noise_is_known:
        return "the noise of the sensor is assumed, not measured", "rig calibrate sensor"
    return (
        "no constant profile fits it: it flickers, or the sensor's noise is not as stated",
        "let the laser warm up, shield the beam from air; rig calibrate sensor",
    )
