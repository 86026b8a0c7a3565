"""What runs no longer though nobody has stopped it, as a managed system that can tell has it."""

from kb.elements import Component, ComponentKind
from kb.exceptions import UnknownName
from kb.knowledge_base import KnowledgeBase
from kb.managed import ManagedSystem, is_active

__all__ = ["Activity"]


class Activity:
    """A monitor that asks after each component that is believed to be active, while no plan is being carried out.

    One that was started by the last command to it, and is not running, has failed. Any other belief that is wrong is
    only put right: a component may have been stopped while the program was not there to see it.

    Args:
        managed: what is asked; nothing is done if it cannot tell.
    """

    def __init__(self, managed: ManagedSystem) -> None:
        self._managed = managed
        self._met: KnowledgeBase | None = None
        self._strangers: set[str] = set()
        self._believed: list[str] = []
        self._believed_at = -1

    def observe(self, kb: KnowledgeBase) -> None:
        """Tell what is not active, though it should be."""
        if not callable(getattr(self._managed, "is_active", None)) or kb.pending_plan is not None:
            return
        if kb is not self._met or kb.revision != self._believed_at:
            self._believed, self._believed_at = _believed(kb), kb.revision
        for name in [name for name in self._believed if self._has_ended(name)]:
            reason = f"{name} is not running, though nobody has stopped it"
            was_started = kb is self._met and _was_started(kb, name)
            kb.component_active(name, False, reason)
            if was_started:
                kb.component_failed(name, reason)
        self._met = kb

    def _has_ended(self, name: str) -> bool:
        if name in self._strangers:
            return False
        try:
            return is_active(self._managed, name) is False
        except UnknownName:  # it is not this system that manages it
            self._strangers.add(name)
        except Exception:
            return False  # nobody can tell at this moment
        return False


def _believed(kb: KnowledgeBase) -> list[str]:
    """Return the names of the components that are commanded and believed to be active."""
    with kb._lock:
        active = kb._state.active
        elements = [node.element for node in kb._network.components.values() if active[node.index]]
    return [one.name for one in elements if isinstance(one, Component) and one.kind is not ComponentKind.PLAIN]


def _was_started(kb: KnowledgeBase, name: str) -> bool:
    """Tell whether the last command to a component has started it."""
    switches = (one for one in reversed(kb.attempts) if one.component == name and one.operation != "configure")
    last = next(switches, None)
    return last is not None and (last.operation, last.result) == ("activate", "completed")
