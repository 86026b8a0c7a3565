"""A judge of models: what can never work, contradicts itself or is likely a slip."""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from kb.model import Model

__all__ = ["Finding", "check_model"]


@dataclass(frozen=True, slots=True)
class Finding:
    """Something about a model that its author should look at."""


def check_model(model: "Model", names: Iterable[str] | None = None) -> tuple[Finding, ...]:
    """Judge a model; see `Model.check`."""
    raise NotImplementedError
