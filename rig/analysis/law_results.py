"""What results.json says of several laws that were fitted to one run."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from math import inf

from rig.analysis.encoding import Number, Value


@dataclass(frozen=True, slots=True, kw_only=True)
class LawFit:
    """One law at its best. `bic_above_best` is its distance from the best law in Schwarz's criterion, and
    `ground_rad_per_s2_rthz` the drive that it needs; `problem` says why there is no fit."""

    title: str
    source: str
    parameters: Mapping[str, Value] = field(default_factory=dict)
    bic_above_best: Number = inf
    ground_rad_per_s2_rthz: Number = inf
    residuals_are_noise: bool = False
    excluded: bool = True
    problem: str = ""


@dataclass(frozen=True, slots=True)
class ComparedLaws:
    """Laws by name, the best first, and the verdict in words."""

    laws: Mapping[str, LawFit]
    verdict: str
