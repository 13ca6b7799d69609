"""Plans a campaign's runs again and again, each time after those that were made."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from rig.campaigns.likelihoods import FoundRun
from rig.campaigns.planned import PlannedCampaign, Within, plan_campaign, ready_s
from rig.campaigns.stated import StatedCampaign, read_campaign
from rig.campaigns.targets import read_target
from rig.plan import expected_after, planned_expectation
from rig.settings import load_configuration


@dataclass(frozen=True, kw_only=True)
class AskedPlan:
    """What is asked of a plan: a configuration with its changes, targets, and what runs may be.

    `waits_min` None: an hour where something depends on time, else none. `ground_rad_per_s2_rthz` and
    `witness` are conditions that count whatever runs have seen.
    """

    source: Path
    targets: Sequence[str]
    first_arcsec: Sequence[float]
    last_arcsec: Sequence[float]
    overrides: Sequence[str] = ()
    noise_arcsec: float | None = None
    contact: Path | None = None
    ground_rad_per_s2_rthz: float | None = None
    witness: float | None = None
    waits_min: Sequence[float] | None = None
    campaign: Path | None = None
    samples: Sequence[str] = ()


class Planner:
    """What is expected is made out once; `plan` chooses by it and by the runs so far."""

    def __init__(self, asked: AskedPlan) -> None:
        self.asked = asked
        self.stated = StatedCampaign() if asked.campaign is None else read_campaign(asked.campaign)
        self._targets = [read_target(text, self.stated) for text in asked.targets]
        config = load_configuration(asked.source, asked.overrides)
        self.samples = list(asked.samples) or [config.session.sample or "sample"]
        self._ready_s = ready_s(config)
        self._expected = planned_expectation(asked.source, asked.overrides, asked.noise_arcsec, asked.contact)

    def plan(
        self,
        found: Sequence[FoundRun] = (),
        *,
        longest_s: float = math.inf,
        most_runs: int = 200,
        learns: bool = False,
    ) -> PlannedCampaign:
        """The runs that reach the targets soonest, after those that were found; with `learns` it is asked
        again after each.

        Raises
        ------
        DataError
            No run may be made between the amplitudes.
        """
        asked = self.asked
        expected = expected_after(self._expected, [one.run for one in found])
        conditions = expected.conditions
        if asked.ground_rad_per_s2_rthz is not None:
            conditions = conditions.on_ground(asked.ground_rad_per_s2_rthz)
        if asked.witness is not None:
            conditions = conditions.with_witness(asked.witness)
        in_time = self.stated.covariates & {"age_s", "dwell_s"}
        # waiting only costs where nothing depends on time
        usual_min = [0.0, 60.0] if in_time else [0.0]
        waits_min = usual_min if asked.waits_min is None else asked.waits_min
        within = Within(
            first_arcsec=asked.first_arcsec,
            last_arcsec=asked.last_arcsec,
            waits_s=[60.0 * minutes for minutes in waits_min],
            samples=self.samples,
            ready_s=self._ready_s,
            longest_s=longest_s,
            most_runs=most_runs,
        )
        return plan_campaign(
            expected._replace(conditions=conditions), self.stated, self._targets, within, found, learns=learns
        )
