"""One model over many runs."""

from collections.abc import Sequence
from pathlib import Path

from rig.campaigns import Campaign, StatedCampaign, answer_of, read_campaign, runs_of_folders, save_campaign
from rig.scripting.given import path_of, several
from rig.scripting.session import Session


def campaign(
    sessions: Sequence[str | Path | Session],
    stated: str | Path | None = None,
    *,
    sample: bool = False,
    output: str | Path | None = None,
) -> Campaign:
    """Fit one model over the runs of several sessions, as `rig campaign` does.

    Parameters
    ----------
    sessions
        Folders of sessions, results files, or sessions, in the order in which they were measured. Each is a
        contact.
    stated
        TOML file with parameters, effects and priors; None: all parameters, no effects.
    sample
        The full posterior by a sampler (emcee) in the place of Laplace's method.
    output
        Folder for campaign.json, page, figures and tables; None: nothing is written.

    Returns
    -------
    Campaign
        ``results`` is the content of campaign.json, ``posterior`` has the draws.

    Raises
    ------
    RigError
        Results cannot be read, a run is there twice, or something is stated that there is not.
    """
    folders = [
        one.folder if isinstance(one, Session) else path_of(one, "sessions")
        for one in several(sessions, (Session,), "sessions")
    ]
    folder = None if output is None else path_of(output, "output")
    known = StatedCampaign() if stated is None else read_campaign(path_of(stated, "stated"))
    found = answer_of(runs_of_folders(folders), known, sample=sample)
    if folder is not None:
        save_campaign(found, folder)
    return found
