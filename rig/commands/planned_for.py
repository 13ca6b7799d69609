"""`rig plan --for`: the runs that reach a target soonest, and the plan file with them."""

import math
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from acquisition.record import whole_file
from processing.errors import ConfigurationError
from rig.campaigns import (
    StatedCampaign,
    Within,
    campaign_plan_files,
    campaign_plan_table,
    plan_campaign,
    read_campaign,
    read_target,
    ready_s,
    runs_of_folders,
)
from rig.plan import planned_expectation
from rig.presentation import answer, print_tables
from rig.settings import load_configuration


class Asked(NamedTuple):
    """What the command line says of the plan."""

    source: Path
    targets: Sequence[str]
    first_arcsec: Sequence[float]
    last_arcsec: Sequence[float]
    overrides: Sequence[str]
    noise_arcsec: float | None
    contact: Path | None
    ground_rad_per_s2_rthz: float | None
    witness: float | None
    waits_min: Sequence[float] | None
    campaign: Path | None
    after: Sequence[Path]
    samples: Sequence[str]
    hours: float | None


def plan_for(asked: Asked, output: Path | None) -> None:
    """Print which runs reach the targets, why, and how long they take; in `output` the plan's file."""
    stated = StatedCampaign() if asked.campaign is None else read_campaign(asked.campaign)
    targets = [read_target(text, stated) for text in asked.targets]
    config = load_configuration(asked.source, asked.overrides)
    samples = list(asked.samples) or [config.session.sample or "sample"]
    if len(samples) > 1 and asked.after:
        raise ConfigurationError(
            f"--after: its runs are of one sample, and {len(samples)} are named by --sample: plan each alone"
        )
    expected = planned_expectation(asked.source, asked.overrides, asked.noise_arcsec, asked.contact)
    conditions = expected.conditions
    if asked.ground_rad_per_s2_rthz is not None:
        conditions = conditions.on_ground(asked.ground_rad_per_s2_rthz)
    if asked.witness is not None:
        conditions = conditions.with_witness(asked.witness)
    in_time = stated.covariates & {"age_s", "dwell_s"}
    # waiting only costs where nothing depends on time
    waits_min = asked.waits_min if asked.waits_min is not None else [0.0, 60.0] if in_time else [0.0]
    within = Within(
        first_arcsec=asked.first_arcsec,
        last_arcsec=asked.last_arcsec,
        waits_s=[60.0 * minutes for minutes in waits_min],
        samples=samples,
        ready_s=ready_s(config),
        longest_s=math.inf if asked.hours is None else 3600.0 * asked.hours,
    )
    found = runs_of_folders(asked.after) if asked.after else ()
    planned = plan_campaign(expected._replace(conditions=conditions), stated, targets, within, found)
    print_tables([campaign_plan_table(planned)])
    if output is None:
        return
    output.mkdir(parents=True, exist_ok=True)
    for name, text in campaign_plan_files(planned, asked.source, output, asked.overrides).items():
        whole_file.write_new(output / name, text.encode())
        answer(written=[output / name])
        print(f"{'plan':<12} {output / name}")
