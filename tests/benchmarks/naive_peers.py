"""The naive twin as a peer: it computes every status again after each event, without and with indices."""

import sys
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path

from generated import Happening

from kb import KnowledgeBase, Model

sys.path.append(str(Path(__file__).parents[1] / "kb"))  # the twin is the oracle of the tests there

from naive import Naive

__all__ = ["IndexedPeer", "NaivePeer", "facts", "keys", "views"]

Key = tuple[str, str | int]


def keys(model: Model) -> Iterator[Key]:
    """Yield kind and name of all that has a status; constraints are known by their position."""
    tables = {
        "configuration": model.configurations,
        "component": model.components,
        "design": model.designs,
        "function": model.functions,
        "action": model.actions,
    }
    yield from (("constraint", number) for number in range(len(model.constraints)))
    yield from ((kind, name) for kind, table in tables.items() for name in table)


def views(kb: KnowledgeBase) -> dict[Key, object]:
    """Return what to ask for each status."""
    model, found, seen = kb.model, {}, defaultdict(int)
    kinds = {
        "Action": "action",
        "FunctionDesign": "design",
        "Component": "component",
        "Configuration": "configuration",
    }
    own = {}
    for number, constraint in enumerate(model.constraints):
        for element in constraint.constrained:
            key = kinds[type(element).__name__], element.name
            own.setdefault(number, (key, seen[key]))
            seen[key] += 1
    for kind, name in keys(model):
        if kind == "constraint":
            (whole, holder), position = own[name]
            found[kind, name] = getattr(kb, f"{whole}s")[holder].constraints[position]
        else:
            found[kind, name] = getattr(kb, f"{kind}s")[name]
    return found


def facts(kb: KnowledgeBase) -> Iterator[Happening]:
    """Yield all that a knowledge base was told and that holds."""
    for attribute in kb.attributes.values():
        if attribute.value is not None:
            yield Happening("measured", attribute.name, attribute.value)
    for component in kb.components.values():
        if component.is_active:
            yield Happening("active", component.name, True)
    for required in kb.required_actions:
        yield Happening("requested", required.action, True)
    for chosen in (*kb.designs.values(), *kb.configurations.values()):
        if chosen.is_selected:
            yield Happening("selected", chosen.name, True)


class NaivePeer(Naive):
    """The naive twin, asked for every status after each event."""

    def __init__(self, model: Model, told: Iterable[Happening]) -> None:
        super().__init__(model)
        self.keys = list(keys(model))
        for happening in told:
            self.note(happening)

    def note(self, happening: Happening) -> None:
        what, name, value = happening
        if what == "measured":
            self.value[name] = value
            return
        chosen = self.designs if name in self.model.designs else self.configurations
        marked = {
            "failed": self.failed,
            "active": self.active,
            "requested": self.open_actions,
            "selected": chosen,
        }
        (marked[what].add if value else marked[what].discard)(name)

    def tell(self, happening: Happening) -> None:
        self.note(happening)
        self.answer = {key: self.status(*key) for key in self.keys}

    def statuses(self) -> Mapping[Key, str]:
        return self.answer


class IndexedPeer(NaivePeer):
    """The same rules; what belongs to what is looked up in indices, and no status is computed twice for an event."""

    def __init__(self, model: Model, told: Iterable[Happening]) -> None:
        super().__init__(model, told)
        self.known = {}
        self.constraints_by_element, self.designs_by_function = defaultdict(list), defaultdict(list)
        self.configurations_by_component, self.designs_by_component = (
            defaultdict(list),
            defaultdict(list),
        )
        self.actions_by_function = defaultdict(list)
        for number, constraint in enumerate(model.constraints):
            for element in constraint.constrained:
                self.constraints_by_element[element].append(number)
        for configuration in model.configurations.values():
            self.configurations_by_component[configuration.component].append(configuration)
        for design in model.designs.values():
            self.designs_by_function[design.function].append(design)
            for component in design.components:
                self.designs_by_component[component].append(design.name)
        for action in model.actions.values():
            for function in action.functions:
                self.actions_by_function[function].append(action.name)
        self.all_constraints = model.constraints

    def own_constraints(self, element):
        return self.constraints_by_element[element]

    def designs_of(self, function):
        return self.designs_by_function[function]

    def configurations_of(self, component):
        return self.configurations_by_component[component]

    def function_required(self, name):
        by_action = any(self.action_required(action) for action in self.actions_by_function[name])
        return by_action or ("function", name) in self.asserted_required

    def component_required(self, name):
        by_design = any(design in self.designs for design in self.designs_by_component[name])
        return by_design or ("component", name) in self.asserted_required

    def status(self, kind, name):
        key = (kind, name)
        if key not in self.known:
            self.known[key] = super().status(kind, name)
        return self.known[key]

    def tell(self, happening: Happening) -> None:
        self.known.clear()
        super().tell(happening)
