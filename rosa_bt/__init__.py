"""How it is done: py_trees behaviours that ask a knowledge base what is feasible, and tell it what is being done."""

from rosa_bt.behaviours import IsActionFeasible, RosaAction
from rosa_bt.trees import TreeRunner

__all__ = ["IsActionFeasible", "RosaAction", "TreeRunner"]
