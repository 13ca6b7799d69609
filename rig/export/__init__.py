"""The command `rig export`: writes spots, half-cycles and results for other programs."""

from rig.export.session_export import export_session
