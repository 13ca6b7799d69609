"""The view of a record in Rerun, complete or being written: a separate program, and its starters."""

from rig.view.balance_view import BalanceView
from rig.view.record_replay import analyse_replayed, replay_record
from rig.view.running_view import LayoutName, Mode, RunningView
from rig.view.show import show_record
