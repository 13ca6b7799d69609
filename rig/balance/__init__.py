"""`rig balance`: look at the swing, advise one turn, learn from it, look again."""

from rig.balance.balancing import balance_rig

__all__ = ["balance_rig"]
