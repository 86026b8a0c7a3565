"""What the checks of a model can find, how bad that is, and what to do about it."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from enum import StrEnum
from types import MappingProxyType
from typing import Final


class Severity(StrEnum):
    """How bad something is: an error can never work, a warning is likely a slip."""

    ERROR = "error"
    WARNING = "warning"


@dataclass(frozen=True, slots=True)
class Rule:
    """One thing that is looked for: how bad it is, what it is, in general, and what to do about it."""

    severity: Severity
    meaning: str
    advice: str


@dataclass(frozen=True, slots=True)
class Finding:
    """Something about a model that its author should look at.

    Attributes:
        code: a word for what is found, one of `RULES`.
        severity: how bad it is.
        element: kind and name, e.g. "function see"; of what is not in the model, the name that was given.
        message: what is found, and where.
        advice: what to do about it.
        place: where the element stands, as file:line:column; empty if it comes from no file.
    """

    code: str
    severity: Severity
    element: str
    message: str
    advice: str
    place: str = ""

    @property
    def where_and_what(self) -> str:
        """The message after the place."""
        return f"{self.place}: {self.message}" if self.place else self.message

    def __str__(self) -> str:
        return " ".join(f"{self.severity}: {self.where_and_what} [{self.code}]; {self.advice}".split())


_ERRORS: Final = {
    "contradictory-constraints": (
        "the constraints on one element leave no value that satisfies them all",
        "correct one of the constraints, or spread them over several configurations or designs",
    ),
    "function-without-designs": (
        "a function has no design, so it is always unfeasible",
        "declare a design with the components that realise the function, or take the function out",
    ),
    "never-feasible": (
        "what an element needs cannot hold together, whatever is measured",
        "loosen one of the constraints named, or declare another design or configuration that does without it",
    ),
    "unknown-action": (
        "a tree or PDDL domain uses an action that the model does not have",
        "correct the name there, or declare the action in the model",
    ),
}
_WARNINGS: Final = {
    "action-without-functions": (
        "an action requires no function, so nothing of the robot is configured for it",
        "name the functions that the action requires, if it does require some",
    ),
    "contradictory-facts": (
        "the facts that a model states from the start do not go together",
        "state only what can be so at one moment",
    ),
    "design-without-components": (
        "a design has no component, so it works whatever fails",
        "name the components of the design, if it has some",
    ),
    "file-note": (
        "something in a file was understood otherwise than it stands there, or not at all",
        "correct it in the file",
    ),
    "hidden-status": (
        "a status is stated by the model, so what would be inferred is hidden until it is retracted",
        "leave the status out and state the facts that it would follow from",
    ),
    "missing-estimation": (
        "an attribute that can be preferred is estimated for some of the choices only, or for none",
        "state an estimation for each of the choices, 0 for those without effect",
    ),
    "missing-parameter": (
        "a configuration leaves out a parameter that all the others of its component set",
        "set the parameter here too; otherwise the configuration before decides its value",
    ),
    "never-selected": (
        "a design or configuration is never the first choice: whenever it is feasible a preferred one is, or its "
        "component is unfeasible",
        "swap the priorities, constrain the preferred one, or take out what is never selected",
    ),
    "similar-names": (
        "two names of one kind differ only in case, underscores or spaces",
        "make sure that two things are meant, and name them so that they can be told apart",
    ),
    "tied-priorities": (
        "designs of one function, or configurations of one component, have the same priority",
        "give each its own priority; the lowest number is chosen first, and a tie goes by name",
    ),
    "unmentioned-action": (
        "no tree or PDDL domain mentions an action of the model",
        "use the action, or take it out of the model",
    ),
    "unused-attribute": (
        "nothing constrains, estimates or prefers an attribute, so measuring it changes nothing",
        "constrain something by it, or take it out",
    ),
    "unused-component": (
        "no design uses a component",
        "add it to the designs that need it, or take it out; maybe one of them names another by mistake",
    ),
    "unused-function": (
        "no action requires a function",
        "have an action require it, or take it out",
    ),
}
RULES: Final[Mapping[str, Rule]] = MappingProxyType(
    {code: Rule(Severity.ERROR, *texts) for code, texts in _ERRORS.items()}
    | {code: Rule(Severity.WARNING, *texts) for code, texts in _WARNINGS.items()}
)
"""What is looked for, by code."""


def found(code: str, element: str, message: str) -> Finding:
    """Make a finding by the rule of that code."""
    rule = RULES[code]
    return Finding(code, rule.severity, element, message, rule.advice)


def listing(names: Iterable[str], most: int = 4) -> str:
    """Write names as a list of which only the first few are told, e.g. "a, b and c" or "a, b, c and 7 more"."""
    known = list(names)
    if len(known) > most:
        known = [*known[: most - 1], f"{len(known) - most + 1} more"]
    return " and ".join([", ".join(known[:-1]), known[-1]] if len(known) > 1 else known)
