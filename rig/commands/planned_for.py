"""`rig plan --for`: the runs that reach a target soonest, and the plan file with them."""

import math
from pathlib import Path

from acquisition.record import whole_file
from processing.errors import ConfigurationError
from rig.campaigns import AskedPlan, NamedRuns, Planner, campaign_plan_files, campaign_plan_table
from rig.presentation import answer, print_tables


def plan_for(asked: AskedPlan, made: NamedRuns, hours: float | None, output: Path | None) -> None:
    """Print which runs reach the targets after those that were made, why, and how long they take; in `output`
    the plan's files."""
    if len(asked.samples) > 1 and (made.folders or made.archive is not None):
        raise ConfigurationError(
            f"{'--after' if made.folders else '--archive'}: its runs are of one sample, and "
            f"{len(asked.samples)} are named by --sample: plan each alone"
        )
    planner = Planner(asked)
    planned = planner.plan(made.of_one_sample(), longest_s=math.inf if hours is None else 3600.0 * hours)
    print_tables([campaign_plan_table(planned)])
    if output is None:
        return
    output.mkdir(parents=True, exist_ok=True)
    for name, text in campaign_plan_files(planned, asked, made, output).items():
        whole_file.write_new(output / name, text.encode())
        answer(written=[output / name])
        print(f"{'plan':<12} {output / name}")
