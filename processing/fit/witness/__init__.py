"""A witness of the ground: a record of what moves the pendulum, with a response that is not known."""

from processing.fit.witness.fitting import Witnessed, fit_with_witness
from processing.fit.witness.signals import Witness
from processing.fit.witness.use import Response, WitnessUse, WitnessVerdict
