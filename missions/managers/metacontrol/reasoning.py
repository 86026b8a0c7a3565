"""What Metacontrol infers from what it knows and is told: which objective is in error, and what would serve it best.

The rules are those of TOMASys for what SUAVE uses of it, as pure functions: no reasoner runs.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum

from missions.managers.metacontrol.ontology import Design, Knowledge

__all__ = ["Situation", "Standing", "best_design", "standing", "unrealisable"]


class Standing(StrEnum):
    """How an objective stands; the first that holds."""

    UNGROUNDED = "UNGROUNDED"
    """No design serves it."""
    COMPONENT_ERROR = "IN_ERROR_COMPONENT"
    """Its design needs a component that has failed."""
    FUNCTION_ERROR = "IN_ERROR_FR"
    """The mode of its design is not in force though it was asked for."""
    QUALITY_ERROR = "IN_ERROR_NFR"
    """A quality that its design needs is measured to be less."""
    UPDATABLE = "UPDATABLE"
    """A component has recovered: something better may be possible."""
    SATISFIED = "SATISFIED"
    """All is well."""


@dataclass(frozen=True, slots=True)
class Situation:
    """What Metacontrol has been told, and what it inferred in the pass before.

    Attributes:
        measured: last value by attribute.
        failed: components that have failed.
        unrealisable: names of designs that need one of these, as inferred by the pass before.
        grounded: names of the designs that serve objectives, by function.
        not_in_force: functions whose mode is not in force though it was asked for.
        errors: names of designs that could not be brought into force.
        recovered: whether a component has recovered since the last choice.
    """

    measured: Mapping[str, float] = field(default_factory=dict)
    failed: frozenset[str] = frozenset()
    unrealisable: frozenset[str] = frozenset()
    grounded: Mapping[str, str] = field(default_factory=dict)
    not_in_force: frozenset[str] = frozenset()
    errors: frozenset[str] = frozenset()
    recovered: bool = False


def unrealisable(knowledge: Knowledge, situation: Situation) -> frozenset[str]:
    """Return the names of the designs that need a component which has failed."""
    return frozenset(one.name for one in knowledge.designs if not situation.failed.isdisjoint(one.components))


def standing(knowledge: Knowledge, situation: Situation, function: str) -> Standing:
    """Return how the objective of a function stands."""
    design = next((one for one in knowledge.of(function) if one.name == situation.grounded.get(function)), None)
    if design is None:
        return Standing.UNGROUNDED
    if design.name in situation.unrealisable:
        return Standing.COMPONENT_ERROR
    if function in situation.not_in_force:
        return Standing.FUNCTION_ERROR
    if not _suffices(design, situation):
        return Standing.QUALITY_ERROR
    return Standing.UPDATABLE if situation.recovered else Standing.SATISFIED


def best_design(knowledge: Knowledge, situation: Situation, function: str) -> Design | None:
    """Return the design of a function that performs best of those that are possible now; None if none is."""
    barred = situation.unrealisable | situation.errors
    possible = (one for one in knowledge.of(function) if one.name not in barred and _suffices(one, situation))
    return next(possible, None)


def _suffices(design: Design, situation: Situation) -> bool:
    """Tell whether no quality that a design needs is measured to be less; what is not measured suffices."""
    measured = situation.measured
    return all(not measured[name] < value for name, value in design.qualities if name in measured)
