"""Planners: what is asked for a plan, what it answers, and what each way of planning is made of."""

from rosa_pddl.planning.engines import register_engine
from rosa_pddl.planning.lock_step import awaited
from rosa_pddl.planning.outcomes import Attempt, Outcome, PlanningResult, TimedStep
from rosa_pddl.planning.planner import Planner
from rosa_pddl.planning.schedule import schedule_flaw

__all__ = [
    "Attempt",
    "Outcome",
    "Planner",
    "PlanningResult",
    "TimedStep",
    "awaited",
    "register_engine",
    "schedule_flaw",
]
