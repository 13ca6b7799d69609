"""`rig paper`: the paper's tables and figures, reproduced with the simulated rig."""

from rig.paper.paper_report import reproduce_paper
