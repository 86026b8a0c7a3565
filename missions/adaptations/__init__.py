"""What of a run was adaptation: what set each off, what was changed, why, and how long that took."""

from missions.adaptations.adaptation import Adaptation
from missions.adaptations.log import AdaptationLog

__all__ = ["Adaptation", "AdaptationLog"]
