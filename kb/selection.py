"""Which of several possibilities to choose; pure, so that it can be replaced and tried by itself."""

from collections.abc import Iterable, Mapping
from typing import NamedTuple, Protocol

__all__ = ["Candidate", "Choice", "first_by_priority"]


class Candidate(Protocol):
    """Something that can be chosen: a function design or a component configuration."""

    @property
    def name(self) -> str:
        """Its name."""

    @property
    def priority(self) -> int | None:
        """Its priority; the lowest number is preferred."""


class Choice(NamedTuple):
    """A design for each function and a configuration for each component that has some, by name."""

    designs: Mapping[str, str]
    configurations: Mapping[str, str]


def first_by_priority(candidates: Iterable[Candidate]) -> str | None:
    """Name of the candidate with the lowest priority number; no priority comes last, ties go by name; None for none."""
    ranked = sorted(
        candidates, key=lambda one: (one.priority is None, 0 if one.priority is None else one.priority, one.name)
    )
    return ranked[0].name if ranked else None
