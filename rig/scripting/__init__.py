"""Functions and classes of `import rig` for scripts and notebooks: records, fits, campaigns, figures."""

from rig.report import Campaign
from rig.scripting.fits import campaign, curves, fit, fit_film, fit_table
from rig.scripting.session import Record, Session, figures, open_record, open_session
