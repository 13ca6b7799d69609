"""What is stated of a campaign, as the model takes it."""

from collections.abc import Sequence
from math import log

import numpy as np

from processing.campaign import FRICTION, POSITIVE, CampaignModel, CompressedRun
from processing.contact import DRAG
from processing.contact.laws import DEFAULT_LAW
from processing.errors import ConfigurationError
from processing.estimate import Estimate
from rig.campaigns.stated import StatedCampaign


def names_of(stated: StatedCampaign, runs: Sequence[CompressedRun]) -> tuple[str, ...]:
    """The parameters that are modelled."""
    known = (*DEFAULT_LAW.names(), DRAG.key)
    if unknown := [name for name in stated.parameters if name not in known]:
        raise ConfigurationError(f"parameters: there is no {unknown[0]!r}; a campaign has {', '.join(known)}")
    if unknown := [name for name in stated.size if name not in (*known, FRICTION)]:
        raise ConfigurationError(
            f"size.{unknown[0]}: there is no such parameter; a campaign has {', '.join(known)}"
        )
    seen = {name for run in runs for name in (*run.names, *run.bounds)}
    return stated.parameters or tuple(name for name in known if name in seen)


def refuse_other_contacts(stated: StatedCampaign, runs: Sequence[CompressedRun]) -> None:
    """Raise ConfigurationError for an effect of a contact of which no run enters."""
    contacts = list(dict.fromkeys(run.contact for run in runs))
    for one in (*stated.effect, *stated.candidate):
        if one.contact and one.contact not in contacts:
            raise ConfigurationError(
                f"contact = {one.contact!r}: no such contact; the runs are of {', '.join(contacts)}"
            )


def model_of(
    stated: StatedCampaign, names: tuple[str, ...], reference_rad: float, runs: Sequence[CompressedRun]
) -> CampaignModel:
    """What is stated, as the model takes it."""
    levels = {}
    for name, prior in stated.prior.items():
        if name not in names:
            raise ConfigurationError(f"prior.{name}: is not one of the parameters {', '.join(names)}")
        value, u = prior.value, prior.u
        if name in POSITIVE:
            if not value > 0:
                raise ConfigurationError(f"prior.{name}.value = {value:g}: should be above 0")
            value, u = log(value), u / value
            # beside the middle of what the runs say of the exponent
            for of, exponent, less in (("b", "p", 1.0), ("gamma_pa", "n", 0.0)):
                if name == of:
                    middle = np.median(
                        [r.values[r.names.index(exponent)] for r in runs if exponent in r.names]
                    )
                    value += (float(middle) - less) * log(reference_rad)
        levels[name] = Estimate(value, u)
    return CampaignModel(
        names=names,
        effects=stated.effects,
        sizes=stated.size,
        levels=levels,
        contacts_alike=stated.contacts_alike,
        bad_run_chance=stated.bad_run_chance,
    )
