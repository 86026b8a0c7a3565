"""What the ROSA paper (Silva et al., table on development effort and the section after it) counts."""

from collections.abc import Mapping
from types import MappingProxyType
from typing import Final, NamedTuple

__all__ = ["MODELS", "Parts", "TASK_NODES", "TREES", "law"]


class Parts(NamedTuple):
    """A number that is counted in two parts."""

    first: int
    second: int

    @property
    def total(self) -> int:
        """Both together."""
        return self.first + self.second

    def __str__(self) -> str:
        return f"{self.first} + {self.second} = {self.total}"


MODELS: Final[Mapping[str, Parts]] = MappingProxyType(
    {"suave": Parts(18, 12), "suave_extended": Parts(22, 16), "agv": Parts(18, 36), "uav": Parts(24, 16)}
)
"""Entities and relations of each model."""

TREES: Final[Mapping[str, Parts]] = MappingProxyType({"suave": Parts(27, 30), "suave_extended": Parts(34, 38)})
"""For the tree that manages: nodes without those of the task, and modes with their parameters."""

TASK_NODES: Final[Mapping[str, int]] = MappingProxyType({"suave": 10, "suave_extended": 16})
"""Nodes of the tree with the task only, which are deducted from those of the tree that manages."""


def law(structural: int, parameter: int) -> int:
    """Return how many elements one action needs with that many structural and parameter adaptations."""
    return 10 + 6 * structural + 3 * parameter
