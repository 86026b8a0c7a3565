"""In which ways the robot can be configured in a situation, and what each takes: read off the knowledge base."""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from itertools import product

from kb import Choice, KnowledgeBase, Model, Situation
from kb.elements import Constraint, EstimationKind
from kb.status import OPERATORS

__all__ = ["Mode", "Modes", "running_mode"]


@dataclass(frozen=True, eq=False)
class Mode:
    """One way to be configured; the same one is the same object, for one `Modes`.

    Attributes:
        name: of designs and configurations, such as "amcl_kinect fast"; empty if nothing runs.
        choice: a design for each function and a configuration for each component that has some.
        components: that run.
        parameters: of these, by name.
        estimates: what designs, components and configurations are estimated to add to each attribute, summed up;
            less than 0 for what they take away.
    """

    name: str
    choice: Choice = field(repr=False)
    components: frozenset[str] = field(repr=False)
    parameters: Mapping[str, float] = field(repr=False)
    estimates: Mapping[str, float] = field(repr=False)


class Modes:
    """Asks a knowledge base, by situations, which modes of a function are possible under which conditions.

    Conditions that violate the same constraints of the model allow the same modes, so that one situation serves all.
    What was answered is forgotten as soon as a fact or the model has changed.

    Args:
        kb: what to ask; its failures and measurements count.
        function: for which designs are chosen.
        failed: components that are supposed to have failed, too.

    Raises:
        UnknownName: no such function.
    """

    def __init__(self, kb: KnowledgeBase, function: str, failed: Iterable[str] = ()) -> None:
        self._kb = kb
        self._supposed = tuple(failed)
        self._function = kb.functions[function].name
        self._revision = -1
        self._constraints: dict[str, list[Constraint]] = {}
        self._found: dict[tuple[object, ...], tuple[Mode, ...]] = {}
        self._reasons: dict[tuple[object, ...], str] = {}
        self._made: dict[tuple[object, ...], Mode] = {}

    def under(self, conditions: Mapping[str, float]) -> tuple[Mode, ...]:
        """Return the modes that are possible while attributes have these values; none if the function is unfeasible."""
        key = self._key(conditions)
        if key not in self._found:
            self._found[key] = tuple(self._possible(self._situation(conditions)))
        return self._found[key]

    def why_none(self, conditions: Mapping[str, float]) -> str:
        """Say why nothing is possible while attributes have these values."""
        key = self._key(conditions)
        if key not in self._reasons:
            situation = self._situation(conditions)
            self._reasons[key] = situation.why(situation.functions[self._function])
        return self._reasons[key]

    def _key(self, conditions: Mapping[str, float]) -> tuple[object, ...]:
        """Return which constraints hold; for one with hysteresis, which depends on more than the value, the value."""
        if self._revision != self._kb.revision:
            self._forget()
        return tuple(
            [
                value if one.hysteresis else OPERATORS[one.operator](value, one.value)
                for attribute, value in conditions.items()
                for one in self._constraints.get(attribute, ())
            ]
        )

    def _forget(self) -> None:
        self._revision = self._kb.revision
        self._found, self._reasons, self._constraints = {}, {}, {}
        for one in self._kb.model.constraints:
            self._constraints.setdefault(one.attribute, []).append(one)

    def _situation(self, conditions: Mapping[str, float]) -> Situation:
        return self._kb.situation(conditions, failed=self._supposed)

    def _possible(self, situation: Situation) -> Iterator[Mode]:
        model = self._kb.model
        for design in situation.selectable_designs(self._function):
            parts = model.designs[design].components
            configured = [part for part in parts if situation.components[part].configurations]
            for chosen in product(*(situation.selectable_configurations(part) for part in configured)):
                choice = Choice({self._function: design}, dict(zip(configured, chosen, strict=True)))
                made = _mode(model, choice, frozenset(parts))
                held = (tuple(made.parameters.items()), tuple(made.estimates.items()))
                yield self._made.setdefault((design, chosen, made.components, held), made)


def running_mode(kb: KnowledgeBase, function: str) -> Mode:
    """Return how the robot is configured now: the components of the function's designs that are active."""
    model = kb.model
    parts = {part for one in model.designs.values() if one.function == function for part in one.components}
    active = [part for part in model.components if part in parts and kb.components[part].is_active]
    selected = {part: kb.components[part].selected_configuration for part in active}
    configured = {part: name for part, name in selected.items() if name}
    return _mode(model, Choice({}, configured), frozenset(active))


def _mode(model: Model, choice: Choice, components: frozenset[str]) -> Mode:
    names = [*choice.designs.values(), *choice.configurations.values()]
    chosen = {id(model.designs[one]) for one in choice.designs.values()}
    chosen |= {id(model.configurations[one]) for one in choice.configurations.values()}
    chosen |= {id(model.components[one]) for one in components}
    estimates: dict[str, float] = {}
    for one in model.estimations:
        if id(one.causer) in chosen:
            sign = -1.0 if one.kind is EstimationKind.NEGATIVE else 1.0
            estimates[one.attribute] = estimates.get(one.attribute, 0.0) + sign * one.value
    parameters: dict[str, float] = {}
    for name in choice.configurations.values():
        for key, value in model.configurations[name].parameters.items():
            if isinstance(value, int | float) and not isinstance(value, bool):
                parameters[key] = float(value)
    return Mode(" ".join(names), choice, components, parameters, estimates)
