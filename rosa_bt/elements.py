"""Elements of a model by name, whatever their kind."""

from collections.abc import Mapping
from typing import Final

from kb import AmbiguousName, InvalidValue, KnowledgeBase, Status, UnknownName
from kb.status import STATUSES
from kb.views import ActionView, ComponentView, ConfigurationView, DesignView, FunctionView

__all__ = ["StatusView", "find_element", "status_of_kind"]

StatusView = ActionView | FunctionView | ComponentView | DesignView | ConfigurationView
"""The view of an element that has a status and a name."""

_KINDS: Final[Mapping[type, str]] = {
    ActionView: "an action",
    FunctionView: "a function",
    ComponentView: "a component",
    DesignView: "a function design",
    ConfigurationView: "a configuration",
}


def find_element(kb: KnowledgeBase, element: str | StatusView) -> StatusView:
    """Return the view of the one element of that name; a view is returned as it is."""
    if not isinstance(element, str):
        return element
    tables: tuple[Mapping[str, StatusView], ...]
    tables = (kb.actions, kb.functions, kb.components, kb.designs, kb.configurations)
    found = [table[element] for table in tables if element in table]
    if not found:
        raise UnknownName("element", element, [name for table in tables for name in table])
    if len(found) > 1:
        kinds = " and ".join(_KINDS[type(view)] for view in found)
        raise AmbiguousName(f"{element!r} names {kinds}; pass the view that is meant, e.g. kb.actions[{element!r}]")
    return found[0]


def status_of_kind(element: StatusView, status: str) -> Status:
    """Return a status by its word; raise unless an element of this kind can have it."""
    kind = _KINDS[type(element)]
    possible = STATUSES[kind.partition(" ")[2]]
    if status in possible:
        return Status(status)
    known = ", ".join(repr(str(one)) for one in possible)
    raise InvalidValue(f"{kind} is never {status!r}; it can be {known}")
