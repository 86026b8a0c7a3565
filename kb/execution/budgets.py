"""Budgets while a plan is carried out: nothing is started that would take what runs beyond one."""

from collections.abc import Collection, Iterable, Mapping
from decimal import Decimal

from kb.elements import Component, Configuration, EstimationKind, FunctionDesign, finite_number
from kb.exceptions import InvalidValue, UnknownName
from kb.knowledge_base import KnowledgeBase

__all__ = ["Budgets"]


class Budgets:
    """What all that is chosen and runs is estimated to use at most, by name of attribute."""

    def __init__(self, most: Mapping[str, float] | None) -> None:
        if not isinstance(most, Mapping | None):
            raise InvalidValue(f"budgets are given as the most by name of attribute, not as {most!r}")
        self._most = {name: finite_number(limit) for name, limit in (most or {}).items()}

    def __bool__(self) -> bool:
        return bool(self._most)

    def check_names(self, kb: KnowledgeBase) -> None:
        """Raise `UnknownName` unless the model has each attribute."""
        for name in self._most:
            if name not in kb.attributes:
                raise UnknownName("attribute", name, kb.attributes)

    def allow(self, kb: KnowledgeBase, started: Iterable[str], failed: Collection[str]) -> bool:
        """Tell whether all that is selected keeps within the budgets once it is carried out.

        Args:
            kb: what is known.
            started: names of the components that are to run beside those that do.
            failed: names of those that are as they were, because a command failed.
        """
        loads = self._loads(kb, started, failed)
        return all(load <= Decimal(repr(limit)) for load, limit in zip(loads, self._most.values(), strict=True))

    def are_eased(self, kb: KnowledgeBase, component: str, failed: Collection[str]) -> bool:
        """Tell whether a component that runs uses no more with its new parameters than with those that it has."""
        after, before = self._loads(kb, (), failed), self._loads(kb, (), {*failed, component})
        return all(new <= old for new, old in zip(after, before, strict=True))

    def _loads(self, kb: KnowledgeBase, started: Iterable[str], failed: Collection[str]) -> list[Decimal]:
        running = {*started, *(one.name for one in kb.components.values() if one.is_active)}
        loads = dict.fromkeys(self._most, Decimal(0))
        for estimation in kb.model.estimations:
            if estimation.attribute in loads and _counts(kb, estimation.causer, running, failed):
                value = Decimal(repr(estimation.value))
                loads[estimation.attribute] += -value if estimation.kind is EstimationKind.NEGATIVE else value
        return list(loads.values())


def _counts(kb: KnowledgeBase, causer: object, running: Collection[str], failed: Collection[str]) -> bool:
    if isinstance(causer, Component):
        return causer.name in running
    if not isinstance(causer, Configuration):
        return isinstance(causer, FunctionDesign) and kb.designs[causer.name].is_selected
    if causer.component not in running:
        return False
    component = kb.components[causer.component]
    if component.selected_configuration is None or component.name in failed:
        return dict(component.parameters_in_force) == dict(causer.parameters)
    return component.selected_configuration == causer.name
