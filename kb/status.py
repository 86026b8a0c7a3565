"""The six status tables: which status an element has, as pure functions of what it depends on.

Each function is one table; its lines are tried from the top and the first that holds gives the status, so every
element has exactly one. `inference` decides when a table is consulted again; nothing else decides a status.
The conceptual model is that of ROSA (Silva et al., "ROSA: a knowledge-based solution for robot self-adaptation").
"""

import operator
from collections.abc import Callable, Iterable, Mapping
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
        "function": "unfeasible, configuration error, implicit configuration error, solved, unsolved, feasible",
        "action": "unfeasible, implicit configuration error, unsolved, solved, feasible",
    }.items()
}
"""The statuses that an element of each kind can have, in the order of its table."""


IMPOSSIBLE = frozenset({Status.UNFEASIBLE, Status.FAILURE, Status.VIOLATED})
"""With one of these an element, and what needs it, cannot be."""


def constraint_status(measured: float | None, relation: str, threshold: float) -> Status:
    """Status of a constraint: the latest measurement, if any, against `measured (relation) threshold`."""
    if measured is None:
        return Status.NOT_EVALUATED
    return Status.SATISFIED if OPERATORS[relation](measured, threshold) else Status.VIOLATED


def configuration_status(constraints: Iterable[Status]) -> Status:
    """Status of a component configuration, from its constraints."""
    return Status.UNFEASIBLE if Status.VIOLATED in constraints else Status.FEASIBLE


def component_status(
    *,
    failed: bool,
    constraints: Iterable[Status],
    configurations: Iterable[tuple[Status, bool]],
    required: bool,
    active: bool,
) -> Status:
    """Status of a component, from its own constraints and its configurations: their status, and whether selected."""
    choices = tuple(configurations)
    if failed:
        return Status.FAILURE
    if choices and all(status is Status.UNFEASIBLE for status, _ in choices):
        return Status.UNFEASIBLE
    if Status.VIOLATED in constraints:
        return Status.UNFEASIBLE
    if not required:
        return Status.FEASIBLE
    if any(selected and status is Status.UNFEASIBLE for status, selected in choices):
        return Status.CONFIGURATION_ERROR
    if not active or (choices and not any(selected for _, selected in choices)):
        return Status.UNSOLVED
    return Status.SOLVED


def design_status(*, constraints: Iterable[Status], components: Iterable[Status], selected: bool) -> Status:
    """Status of a function design, from its own constraints and the components it is made of."""
    parts = tuple(components)
    if Status.VIOLATED in constraints or Status.FAILURE in parts or Status.UNFEASIBLE in parts:
        return Status.UNFEASIBLE
    if not selected:
        return Status.FEASIBLE
    if Status.CONFIGURATION_ERROR in parts:
        return Status.IMPLICIT_CONFIGURATION_ERROR
    return Status.SOLVED if all(part is Status.SOLVED for part in parts) else Status.UNSOLVED


def function_status(*, designs: Iterable[tuple[Status, bool]], required: bool) -> Status:
    """Status of a function, from its designs: the status of each, and whether that one is selected."""
    choices = tuple(designs)
    if all(status is Status.UNFEASIBLE for status, _ in choices):
        return Status.UNFEASIBLE
    if not required:
        return Status.FEASIBLE
    chosen = [status for status, selected in choices if selected]
    if Status.UNFEASIBLE in chosen:
        return Status.CONFIGURATION_ERROR
    if Status.IMPLICIT_CONFIGURATION_ERROR in chosen:
        return Status.IMPLICIT_CONFIGURATION_ERROR
    return Status.SOLVED if Status.SOLVED in chosen else Status.UNSOLVED


def action_status(*, constraints: Iterable[Status], functions: Iterable[Status], required: bool) -> Status:
    """Status of an action, from its own constraints and the functions that it requires."""
    needs = tuple(functions)
    if Status.VIOLATED in constraints or Status.UNFEASIBLE in needs:
        return Status.UNFEASIBLE
    if not required:
        return Status.FEASIBLE
    if Status.CONFIGURATION_ERROR in needs or Status.IMPLICIT_CONFIGURATION_ERROR in needs:
        return Status.IMPLICIT_CONFIGURATION_ERROR
    return Status.SOLVED if all(need is Status.SOLVED for need in needs) else Status.UNSOLVED
