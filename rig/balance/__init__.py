"""`rig balance`: look at the swing, advise one turn, learn from it, look again."""

from rig.balance.balance_rig import balance_rig

__all__ = ["balance_rig"]
