"""`rig balance`: measures the balance, advises a turn of a weight, learns from it, repeats."""

from rig.balance.balancing import balance_rig, show_history
from rig.balance.dialogue import BalanceDialogue, BalanceStage, InJsonLines, balance_dialogue
