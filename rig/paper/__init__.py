"""`rig paper`: the paper's tables and figures, reproduced with the simulated rig."""

from rig.paper.tables import reproduce_paper
