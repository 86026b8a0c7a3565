"""Decides what to do next: plans in PDDL, executes the plans as py_trees behaviours, replans."""

from rosa_pddl.belief import LastingFeasibility
from rosa_pddl.domain import (
    Domain,
    Feasibility,
    GoalError,
    MissingBehaviourError,
    PddlError,
    PlannerSettingError,
    PlanningBudgetError,
    RosaPddlError,
    Schema,
    SensingError,
    State,
    Step,
    UnknownNameError,
    UnsupportedPddlError,
    feasible_atoms,
    initial_state,
)
from rosa_pddl.executor import PlanExecutor
from rosa_pddl.planner import Certificate, Planner, certificate, wait_for_plan
from rosa_pddl.problem import Outcome, PlanningResult, Problem
from rosa_pddl.reader import Goal, load_domain, parse_domain
from rosa_pddl.replanning import Goals, PlanRecord, ReplanningPolicy
from rosa_pddl.validate import TimedStep, flaw

__all__ = [
    "Certificate",
    "Domain",
    "Feasibility",
    "Goal",
    "GoalError",
    "Goals",
    "LastingFeasibility",
    "MissingBehaviourError",
    "Outcome",
    "PddlError",
    "PlanExecutor",
    "PlanRecord",
    "Planner",
    "PlannerSettingError",
    "PlanningBudgetError",
    "PlanningResult",
    "Problem",
    "ReplanningPolicy",
    "RosaPddlError",
    "Schema",
    "SensingError",
    "State",
    "Step",
    "TimedStep",
    "UnknownNameError",
    "UnsupportedPddlError",
    "certificate",
    "feasible_atoms",
    "flaw",
    "initial_state",
    "load_domain",
    "parse_domain",
    "wait_for_plan",
]
