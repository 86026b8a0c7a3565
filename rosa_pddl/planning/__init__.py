"""Planners: what is asked for a plan, what it answers, and what each way of planning is made of."""

from rosa_pddl.planning.engines import register_engine
from rosa_pddl.planning.lock_step import awaited
from rosa_pddl.planning.outcomes import Attempt, Outcome, PlanningResult
from rosa_pddl.planning.planner import Planner

__all__ = [
    "Attempt",
    "Outcome",
    "Planner",
    "PlanningResult",
    "awaited",
    "register_engine",
]
