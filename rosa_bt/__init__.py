"""How it is done: py_trees behaviours that ask a knowledge base what is feasible, and tell it what is being done."""

from rosa_bt.behaviours import HasStatus, IsActionFeasible, Measurement, RosaAction, WaitForArchitecture
from rosa_bt.decorators import ForAction
from rosa_bt.exceptions import RosaBtError, TreeChangeError
from rosa_bt.idioms import do_until_unfeasible, feasible_then_act, first_feasible, switch_safely
from rosa_bt.requests import forget_progress
from rosa_bt.trees import TreeRunner

__all__ = [
    "ForAction",
    "HasStatus",
    "IsActionFeasible",
    "Measurement",
    "RosaAction",
    "RosaBtError",
    "TreeChangeError",
    "TreeRunner",
    "WaitForArchitecture",
    "do_until_unfeasible",
    "feasible_then_act",
    "first_feasible",
    "forget_progress",
    "switch_safely",
]
