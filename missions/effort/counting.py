"""The size of a model by the ROSA paper's way of counting (Silva et al., section on development effort).

One rule gives the published counts of all four models: what in TypeDB is an entity or a relation counts one. As TypeQL,
a model has a statement for each.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Final

from kb import Model

__all__ = ["Count", "RULE", "count"]

RULE: Final = (
    "entities: actions, functions, components, attributes, parameter values (each key of each configuration)",
    "relations: functional requirements (one for each action), function designs, component configurations, "
    "constraints (one that is shared counts once), estimations",
)
"""What is counted, in two lines."""


@dataclass(frozen=True, slots=True)
class Count:
    """How many elements a model has.

    Attributes:
        of_entities: how many of each kind of entity.
        of_relations: how many of each kind of relation.
    """

    of_entities: Mapping[str, int]
    of_relations: Mapping[str, int]

    @property
    def entities(self) -> int:
        """How many entities there are."""
        return sum(self.of_entities.values())

    @property
    def relations(self) -> int:
        """How many relations there are."""
        return sum(self.of_relations.values())

    @property
    def total(self) -> int:
        """How many elements there are."""
        return self.entities + self.relations

    def __str__(self) -> str:
        return f"{self.entities} entities + {self.relations} relations = {self.total}"


def count(model: Model) -> Count:
    """Count the entities and relations of a model; what is stated to be so from the start is not counted."""
    entities = {
        "actions": len(model.actions),
        "functions": len(model.functions),
        "components": len(model.components),
        "attributes": len(model.attributes),
        "parameter values": sum(len(one.parameters) for one in model.configurations.values()),
    }
    relations = {
        "functional requirements": sum(bool(one.functions) for one in model.actions.values()),
        "function designs": len(model.designs),
        "component configurations": len(model.configurations),
        "constraints": len(model.constraints),
        "estimations": len(model.estimations),
    }
    return Count(MappingProxyType(entities), MappingProxyType(relations))
