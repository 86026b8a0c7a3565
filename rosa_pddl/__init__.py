"""Decides what to do next: plans in PDDL with unified-planning, and executes and replans in a py_trees behaviour."""

from rosa_pddl.belief import LastingFeasibility
from rosa_pddl.domain import (
    Attempt,
    Domain,
    Feasibility,
    Outcome,
    PlanningResult,
    Schema,
    State,
    Step,
    TimedStep,
)
from rosa_pddl.engines import register_engine
from rosa_pddl.exceptions import (
    GoalError,
    MissingBehaviourError,
    PddlError,
    PlannerSettingError,
    PlanningBudgetError,
    RosaPddlError,
    SensingError,
    UnknownNameError,
    UnsupportedPddlError,
)
from rosa_pddl.executor import PlanExecutor
from rosa_pddl.generation import ActionSchema, Declarations, DeclaredProblem
from rosa_pddl.goals import Goals
from rosa_pddl.planner import Certificate, Planner, awaited, certificate
from rosa_pddl.problem import Problem, feasible_atoms, initial_state
from rosa_pddl.reader import load_domain, parse_domain
from rosa_pddl.replanning import PlanRecord, ReplanningPolicy
from rosa_pddl.syntax import Goal
from rosa_pddl.validate import flaw, schedule_flaw

__all__ = [
    "ActionSchema",
    "Attempt",
    "Certificate",
    "Declarations",
    "DeclaredProblem",
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
    "awaited",
    "certificate",
    "feasible_atoms",
    "flaw",
    "initial_state",
    "load_domain",
    "parse_domain",
    "register_engine",
    "schedule_flaw",
]
