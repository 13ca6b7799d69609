"""A witness of the ground: a record of what moves the pendulum, with a response that is not known."""

from processing.fit.witness.fitting import Witnessed as Witnessed
from processing.fit.witness.fitting import fit_with_witness as fit_with_witness
from processing.fit.witness.signals import Witness as Witness
from processing.fit.witness.signals import plain_signals as plain_signals
from processing.fit.witness.spectra import WitnessSpectra as WitnessSpectra
from processing.fit.witness.use import Response as Response
from processing.fit.witness.use import WitnessUse as WitnessUse
from processing.fit.witness.use import WitnessVerdict as WitnessVerdict
