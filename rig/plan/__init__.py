"""What runs to come will tell, from one that was made or a configuration: table and picture of `rig plan`."""

from rig.plan.ageing import ageing_table, plan_ageing
from rig.plan.expected import (
    Expected,
    expected_of,
    expected_of_table,
    planned_expectation,
)
from rig.plan.plan import plan_expected, plan_runs, plan_table, print_plan, save_plan
