"""Functions and classes of `import rig` for scripts and notebooks: records, sessions, fits, figures."""

from rig.scripting.fits import fit, fit_table
from rig.scripting.record import Record, open_record
from rig.scripting.session import Session, figures, open_session
