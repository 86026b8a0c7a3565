"""Planners: what is asked for a plan, what it answers, and what each way of planning is made of."""

from rosa_pddl.planning.outcomes import Attempt, Outcome, PlanningResult, TimedStep
from rosa_pddl.planning.planner import Planner

__all__ = ["Attempt", "Outcome", "Planner", "PlanningResult", "TimedStep"]
