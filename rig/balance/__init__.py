"""The command `rig balance`: measures the balance, advises a turn of a weight, learns from it, repeats."""

from rig.balance.balancing import balance_rig, history_path, show_history
from rig.balance.dialogue import BalanceDialogue, BalanceStage, InJsonLines, balance_dialogue
from rig.balance.history import HEAD, ResponseTable, learned
