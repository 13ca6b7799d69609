"""What runs to come will tell, from one that has been made: the table and the picture of `rig plan`."""

from rig.plan.plan import Plan, plan_runs, print_plan, save_plan

__all__ = ["Plan", "plan_runs", "print_plan", "save_plan"]
