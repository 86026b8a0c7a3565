"""The six status tables: pure functions that give a status from those that it depends on.

Each function is one table: the first line from the top that holds gives the status, so every
element has exactly one. `inference` decides when a table is consulted again; nothing else decides a
status. The conceptual model is that of ROSA (Silva et al., "ROSA: a knowledge-based solution for
robot self-adaptation").
"""

import operator
from collections.abc import Callable, Mapping, Sequence
from enum import StrEnum

OPERATORS: Mapping[str, Callable[[float, float], bool]] = {
    ">=": operator.ge,
    ">": operator.gt,
    "<=": operator.le,
    "<": operator.lt,
}


class Status(StrEnum):
    """Every status an element can have, spelled as ROSA spells it."""

    NOT_EVALUATED = "not evaluated"
    SATISFIED = "satisfied"
    VIOLATED = "violated"
    UNFEASIBLE = "unfeasible"
    FAILURE = "failure"
    CONFIGURATION_ERROR = "configuration error"
    IMPLICIT_CONFIGURATION_ERROR = "implicit configuration error"
    UNSOLVED = "unsolved"
    SOLVED = "solved"
    FEASIBLE = "feasible"


STATUSES: Mapping[str, tuple[Status, ...]] = {
    kind: tuple(Status(word) for word in words.split(", "))
    for kind, words in {
        "constraint": "not evaluated, satisfied, violated",
        "configuration": "unfeasible, feasible",
        "component": "failure, unfeasible, configuration error, unsolved, solved, feasible",
        "function design": "unfeasible, implicit configuration error, unsolved, solved, feasible",
        "function": (
            "unfeasible, configuration error, implicit configuration error, "
            "solved, unsolved, feasible"
        ),
        "action": "unfeasible, implicit configuration error, unsolved, solved, feasible",
    }.items()
}
"""The statuses that an element of each kind can have, in the order of its table."""


# module-level names: their lookup is faster than that of an attribute of the class
(
    NOT_EVALUATED,
    SATISFIED,
    VIOLATED,
    UNFEASIBLE,
    FAILURE,
    ERROR,
    IMPLICIT_ERROR,
    UNSOLVED,
    SOLVED,
    FEASIBLE,
) = Status
IMPOSSIBLE = frozenset({UNFEASIBLE, FAILURE, VIOLATED})
"""An element with one of these statuses cannot be used, nor can anything that needs it."""
Statuses = Sequence[Status]


def constraint_status(measured: float | None, relation: str, threshold: float) -> Status:
    """Status of a constraint: whether `measured (relation) threshold` holds, if measured."""
    if measured is None:
        return NOT_EVALUATED
    return SATISFIED if OPERATORS[relation](measured, threshold) else VIOLATED


def configuration_status(constraints: Statuses) -> Status:
    """Status of a component configuration, from its constraints."""
    return UNFEASIBLE if VIOLATED in constraints else FEASIBLE


def component_status(
    failed: bool,
    constraints: Statuses,
    configurations: Statuses,
    selected: Statuses,
    required: bool,
    active: bool,
) -> Status:
    """Status of a component, from its constraints, its configurations and the selected ones."""
    if failed:
        return FAILURE
    if VIOLATED in constraints or 0 < len(configurations) == configurations.count(UNFEASIBLE):
        return UNFEASIBLE
    if not required:
        return FEASIBLE
    if UNFEASIBLE in selected:
        return ERROR
    return UNSOLVED if not active or (configurations and not selected) else SOLVED


def design_status(constraints: Statuses, components: Statuses, selected: bool) -> Status:
    """Status of a function design, from its own constraints and its components."""
    if VIOLATED in constraints or FAILURE in components or UNFEASIBLE in components:
        return UNFEASIBLE
    if not selected:
        return FEASIBLE
    if ERROR in components:
        return IMPLICIT_ERROR
    return SOLVED if components.count(SOLVED) == len(components) else UNSOLVED


def function_status(designs: Statuses, selected: Statuses, required: bool) -> Status:
    """Status of a function, from all its designs and the selected ones."""
    if designs.count(UNFEASIBLE) == len(designs):
        return UNFEASIBLE
    if not required:
        return FEASIBLE
    if UNFEASIBLE in selected:
        return ERROR
    if IMPLICIT_ERROR in selected:
        return IMPLICIT_ERROR
    return SOLVED if SOLVED in selected else UNSOLVED


def action_status(constraints: Statuses, functions: Statuses, required: bool) -> Status:
    """Status of an action, from its own constraints and the functions that it requires."""
    if VIOLATED in constraints or UNFEASIBLE in functions:
        return UNFEASIBLE
    if not required:
        return FEASIBLE
    if ERROR in functions or IMPLICIT_ERROR in functions:
        return IMPLICIT_ERROR
    return SOLVED if functions.count(SOLVED) == len(functions) else UNSOLVED
