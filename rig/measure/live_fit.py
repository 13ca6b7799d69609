"""Whether a run can be fitted while it is measured, and what then fits it."""

from collections.abc import Sequence

from processing.deflections import DeflectionUnit
from processing.errors import ConfigurationError
from processing.fit import Evidence, points_in_true_time
from processing.periods import mean_period
from processing.swing import Swing, SwingHarmonics
from rig.analysis import clock_rate_of, evidence_of, known_drag, loss_of, stated_surroundings
from rig.instrument import pendulum_on_ball
from rig.posterior import FittedModel, LivePosterior
from rig.settings import Configuration


def live_posterior(config: Configuration) -> LivePosterior | None:
    """What fits the half-cycles of a run as its final analysis will; None where that fits no contact."""
    pendulum = pendulum_on_ball(config)
    if pendulum is None or _why_not(config):
        return None
    clock_rate = clock_rate_of(config)

    def evidence(swings: Sequence[Swing], harmonics: SwingHarmonics) -> Evidence:
        period_s = mean_period(points_in_true_time(swings, clock_rate))
        drag, _ = known_drag(config, stated_surroundings(config), pendulum, period_s)
        return evidence_of(drag, harmonics)

    model = FittedModel(pendulum, config.fit.fits_drag, loss_of(config.fit), clock_rate, config.axes)
    # frames on demand wait for what decides over the end, so that such a run repeats exactly
    in_step = config.on_demand and bool(config.session.stop_when)
    return LivePosterior(model, evidence, in_step=in_step)


def check_stop_when(config: Configuration) -> None:
    """Raise ConfigurationError if `session.stop_when` asks for parameters that this rig does not fit."""
    if config.session.stop_when and (why := _why_not(config)):
        raise ConfigurationError(f"session.stop_when needs the contact's parameters: {why}")


def _why_not(config: Configuration) -> str:
    if config.instrument.description().report != "contact":
        return f"instrument.kind = {config.instrument.kind!r} reports none; leave stop_when out"
    if config.deflection_unit is not DeflectionUnit.RAD:
        return "without [lever] amplitudes are in px; state it, or make it with rig calibrate lever"
    if config.pendulum is None:
        return "state mass_kg and ball_radius_m in [pendulum]"
    return ""
