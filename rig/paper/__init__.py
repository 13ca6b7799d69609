"""The paper's tables and figures made again on the simulated rig."""

from rig.paper.paper_report import reproduce_paper

__all__ = ["reproduce_paper"]
