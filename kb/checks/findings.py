"""What the checks of a model can find, how bad that is, and what to do about it."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from enum import StrEnum
from functools import cache
from pathlib import Path
from types import MappingProxyType


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
        code: a word for what is found, one of `rules()`.
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
        """The message, behind the place it is about if that is known."""
        return f"{self.place}: {self.message}" if self.place else self.message

    def __str__(self) -> str:
        return " ".join(f"{self.severity}: {self.where_and_what} [{self.code}]; {self.advice}".split())


@cache
def rules() -> Mapping[str, Rule]:
    """Return what is looked for, by code: errors first."""
    import tomllib  # it takes a while to import

    read = tomllib.loads(Path(__file__).with_name("rules.toml").read_text(encoding="utf-8"))
    made = {code: Rule(Severity(one["severity"]), one["meaning"], one["advice"]) for code, one in read.items()}
    return MappingProxyType(made)


def found(code: str, element: str, message: str) -> Finding:
    rule = rules()[code]
    return Finding(code, rule.severity, element, message, rule.advice)


def listing(names: Iterable[str], most: int = 4) -> str:
    """Write names as a list of which only the first few are named, e.g. "a, b and c" or "a, b, c and 7 more"."""
    known = list(names)
    if len(known) > most:
        known = [*known[: most - 1], f"{len(known) - most + 1} more"]
    return " and ".join([", ".join(known[:-1]), known[-1]] if len(known) > 1 else known)
