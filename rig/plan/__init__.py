"""What runs to come will tell, from one that was made or a configuration: table and picture of `rig plan`."""

from rig.plan.expected import (
    PlannedContact,
    expected_of,
    expected_of_run,
    expected_of_table,
    planned_expectation,
)
from rig.plan.plan import ageing_table, plan_expected, plan_figure, plan_table, print_plan, save_plan
