"""What a campaign is asked for: an uncertainty, or two forms to be told apart."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from processing.arrays import Floats
from processing.campaign import (
    CampaignModel,
    Effect,
    Goal,
    ratio_against_nothing,
    ratio_between_forms,
    to_coordinates,
)
from processing.errors import ConfigurationError
from rig.campaigns.stated import StatedCampaign, StatedEffect
from rig.settings import stop_condition

_NOTHING = "nothing"
_OR = " or "
CHANCE = 0.95
"""Of the right one of two forms."""


@dataclass(frozen=True)
class Target:
    """A target as it was written; `parameter` and `limit` of an uncertainty, `forms` of two hypotheses."""

    text: str
    parameter: str = ""
    limit: float = 0.0
    forms: tuple[StatedEffect, ...] = ()

    @property
    def effects(self) -> tuple[Effect, ...]:
        """What the model must have to answer."""
        return tuple(one.effect() for one in self.forms)


def read_target(text: str, stated: StatedCampaign) -> Target:
    """Read `u(c)/c < 0.05`, or `FORM or nothing`, `FORM or FORM`, with candidates of the campaign by their
    labels.

    Raises
    ------
    ConfigurationError
        It is neither.
    """
    if _OR not in text:
        try:
            found = stop_condition(text)
        except ValueError as error:
            raise ConfigurationError(
                f"--for: {error}; or name two forms: 'c: linear over humidity_percent or nothing'"
            ) from None
        return Target(text, found.parameter, found.limit)
    labels = [label.strip() for label in text.split(_OR)]
    known = {one.effect().label: one for one in (*stated.candidate, *stated.effect)}
    wrong = [label for label in labels if label != _NOTHING and label not in known]
    if wrong or len(labels) != 2 or labels[0] == labels[1]:
        named = ", ".join(map(repr, known)) or "none: state [[candidate]] in the campaign's file"
        raise ConfigurationError(
            f"--for {text!r}: should be two of 'nothing' and the campaign's forms ({named})"
        )
    return Target(text, forms=tuple(known[label] for label in labels if label != _NOTHING))


def goals_of(
    targets: Sequence[Target], model: CampaignModel, values: Mapping[str, float], reference_rad: float
) -> list[Goal]:
    """Goals of the model; `values` are the parameters that are expected."""
    goals = []
    for target in targets:
        if target.forms:
            for form in target.forms:
                size = model.size(form.parameter)
                margin = size if form.margin is None else form.margin
                ratio = (
                    ratio_against_nothing(CHANCE, size / margin)
                    if len(target.forms) == 1
                    else ratio_between_forms(CHANCE)
                )
                goals.append(Goal(limit=margin / ratio, effect=form.effect()))
            continue
        if target.parameter not in model.names:
            raise ConfigurationError(
                f"--for {target.text!r}: {target.parameter} is not one of the campaign's parameters, "
                f"{', '.join(model.names)}"
            )
        goals.append(
            Goal(limit=target.limit, coordinates=_relative(target.parameter, model, values, reference_rad))
        )
    return goals


def _relative(
    parameter: str, model: CampaignModel, values: Mapping[str, float], reference_rad: float
) -> dict[str, float]:
    """Relative change of a parameter by its campaign's coordinates."""
    found: Floats = np.array([values[name] for name in model.names])
    slopes = np.linalg.inv(to_coordinates(model.names, found, reference_rad).by_parameters)
    row = slopes[model.names.index(parameter)] / abs(values[parameter])
    return {name: share for name, share in zip(model.names, row.tolist(), strict=True) if share}
