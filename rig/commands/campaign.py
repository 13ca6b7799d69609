"""`rig compare --model`: one model over many runs."""

from collections.abc import Sequence
from pathlib import Path

from processing.errors import ConfigurationError
from rig.commands.inputs import there

DEFAULT = "default"
"""In place of a file: the model with nothing stated."""


def model_runs(
    model: str,
    folders: Sequence[Path],
    output: Path | None,
    archive: Path | None,
    where: str,
    *,
    by_sample: bool,
    sample: bool,
) -> None:
    """Fit the model to the runs, print its tables and save what it found in `output`."""
    if archive is None and not folders:
        raise ConfigurationError("rig compare --model needs runs: name folders of sessions, or --archive")
    from rig.analysis import encoded
    from rig.campaigns import (
        NamedRuns,
        StatedCampaign,
        answer_of,
        campaign_tables,
        read_campaign,
        save_campaign,
    )
    from rig.presentation import answer, print_tables, say

    stated = StatedCampaign() if model == DEFAULT else read_campaign(there(Path(model)))
    runs = NamedRuns(list(folders), archive, where, by_sample=by_sample).found()
    found = answer_of(runs, stated, sample=sample)
    answer(campaign=encoded(found.results))
    print_tables(campaign_tables(found))
    for line in (*found.results.left_out, *found.results.warnings):
        say(line)
    if output is not None:
        for path in save_campaign(found, output):
            answer(written=[path])
            print(f"{'campaign':<12} {path}")
