"""What is unfeasible, as defined classes of an ontology that HermiT classifies; the other statuses are left out.

A reasoner of description logic assumes nothing to be complete, so what each element is made of is closed by an
enumeration, and which constraints are violated is told to it.
"""

from collections.abc import Iterable
from typing import Any

from ontology import Ontology

from kb import Model

__all__ = ["Reasoned"]


class Reasoned(Ontology):
    """An ontology of one moment: what is inferred stays in it, so that each moment needs a new one."""

    def __init__(self, model: Model, violated: Iterable[int], failed: Iterable[str]) -> None:
        super().__init__(model)
        with self.ontology:
            self._define()
            for number in violated:
                self.individuals["constraint", number].is_a.append(self.ontology.Violated)
            for name in failed:
                self.individuals["component", name].is_a.append(self.ontology.Failed)
            self._close("component", "configured_by", "configures")
            self._close("function", "realised_by", "realises")

    def _define(self) -> None:
        import types

        from owlready2 import ObjectProperty, Thing

        one = self.ontology
        for name in ("Violated", "Failed", "Configurable"):
            types.new_class(name, (Thing,))
        for name in ("configured_by", "realised_by", "constrained_by"):
            types.new_class(name, (ObjectProperty,))
        one.constrained_by.inverse_property = one.constrains

        def prevented() -> Any:  # a construct belongs to one definition only
            return one.constrained_by.some(one.Violated)

        definitions = {
            "Unfeasible_configuration": lambda: one.configuration & prevented(),
            "Unfeasible_component": lambda: (
                one.component
                & (
                    one.Failed
                    | prevented()
                    | (one.Configurable & one.configured_by.only(one.Unfeasible_configuration))
                )
            ),
            "Unfeasible_design": lambda: (
                one.design & (prevented() | one.uses.some(one.Unfeasible_component))
            ),
            "Unfeasible_function": lambda: (
                one.function & one.realised_by.only(one.Unfeasible_design)
            ),
            "Unfeasible_action": lambda: (
                one.action & (prevented() | one.requires.some(one.Unfeasible_function))
            ),
        }
        for name, definition in definitions.items():
            types.new_class(name, (Thing,)).equivalent_to = [definition()]

    def _close(self, kind: str, relation: str, inverse: str) -> None:
        from owlready2 import OneOf

        parts: dict[Any, list[Any]] = {
            one: [] for key, one in self.individuals.items() if key[0] == kind
        }
        for one in self.individuals.values():
            for whole in getattr(one, inverse):
                parts[whole].append(one)
        for whole, listed in parts.items():
            if not listed:
                continue
            setattr(whole, relation, listed)
            whole.is_a.append(getattr(self.ontology, relation).only(OneOf(listed)))
            if kind == "component":
                whole.is_a.append(self.ontology.Configurable)

    def classify(self) -> None:
        from owlready2 import sync_reasoner_hermit

        sync_reasoner_hermit(self.world, infer_property_values=False, debug=0)

    def unfeasible(self) -> set[tuple[str, str | int]]:
        """Return kind and name of what is unfeasible, or, of a component, in failure."""
        return {
            key
            for key, one in self.individuals.items()
            if any(getattr(kind, "name", "").startswith("Unfeasible") for kind in one.is_a)
        }
