"""What to do next: a replanning executor of PDDL plans on unified-planning, itself a py_trees behaviour."""

from rosa_pddl.domain import Domain, Feasibility, Schema, State, Step
from rosa_pddl.exceptions import (
    MissingBehaviourError,
    PddlError,
    RosaPddlError,
    UnknownNameError,
    UnsupportedPddlError,
)
from rosa_pddl.executor import PlanExecutor, PlanRecord
from rosa_pddl.planning import Outcome, Planner, PlanningResult
from rosa_pddl.problem import Problem, feasible_atoms, initial_state
from rosa_pddl.reader import load_domain

__all__ = [
    "Domain",
    "Feasibility",
    "MissingBehaviourError",
    "Outcome",
    "PddlError",
    "PlanExecutor",
    "PlanRecord",
    "Planner",
    "PlanningResult",
    "Problem",
    "RosaPddlError",
    "Schema",
    "State",
    "Step",
    "UnknownNameError",
    "UnsupportedPddlError",
    "feasible_atoms",
    "initial_state",
    "load_domain",
]
