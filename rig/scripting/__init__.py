"""Functions and classes of `import rig` for scripts and notebooks: records, fits, campaigns, figures."""

from rig.campaigns import Campaign
from rig.scripting.fits import campaign, curves, fit, fit_film, fit_table
from rig.scripting.record import Record, open_record
from rig.scripting.session import Session, figures, open_session, read_results, write_results
