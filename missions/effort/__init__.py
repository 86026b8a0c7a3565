"""Development effort: how large a model is by the ROSA paper's way of counting, and what its author writes."""

from missions.effort.counting import Count, count
from missions.effort.generated import generated_model

__all__ = ["Count", "count", "generated_model"]
