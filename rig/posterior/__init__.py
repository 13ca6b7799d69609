"""What a run says of the contact so far: fitted in a process of its own while it is measured."""

from rig.posterior.posterior import (
    FIRST_HALF_CYCLES,
    LivePosterior,
    Posterior,
    check_stop_when,
    live_posterior,
)
from rig.posterior.worker import FittedModel
