"""What if? The same questions as those to a knowledge base, answered as if some facts were different."""

from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from typing import NamedTuple

from kb import questions
from kb.elements import Constraint, exact, finite_number, listed
from kb.exceptions import InvalidValue
from kb.inference import propagate
from kb.measurements import verdict
from kb.network import Node
from kb.state import Overlay, State
from kb.status import Status
from kb.views import Readable, named, views_of

__all__ = ["Situation", "suppose"]


class _Assumption(NamedTuple):
    what: str
    node: Node
    value: float | None = None

    def __str__(self) -> str:
        if self.what != "measured":
            return f"{self.node.name} {self.what}"
        return f"{self.node.name} {'not measured' if self.value is None else exact(self.value)}"


def suppose(
    base: Readable,
    measured: Mapping[str, float | None] | None = None,
    /,
    *,
    failed: Iterable[str] = (),
    recovered: Iterable[str] = (),
    requested: Iterable[str] = (),
    **attributes: float | None,
) -> "Situation":
    """Return what would be if, to be asked the same questions; the facts stay as they are, and nothing is copied.

    Args:
        base: what it is a situation of; what is said here goes before what was said there.
        measured: values by name of attribute, for names that are no Python names; None is "not measured".
        failed: names of components supposed to have failed.
        recovered: names of components supposed not to have.
        requested: names of actions supposed to be required, even if they are unfeasible.
        attributes: values by name of attribute, e.g. `light=0.3`.
    """
    if not isinstance(measured, Mapping | None):
        raise InvalidValue(f"what is supposed to be measured is given as values by name, not as {measured!r}")
    values = {**(measured or {}), **attributes}
    with base.reading() as state:
        network = state.network
        supposed = [
            _Assumption("measured", named(network.attributes, "attribute", name), _value(name, values[name]))
            for name in values
        ]
        for what, names, kind in (
            ("failed", failed, "component"),
            ("recovered", recovered, "component"),
            ("requested", requested, "action"),
        ):
            wanted = (names,) if isinstance(names, str) else listed(f"names supposed to be {what}", names)
            supposed += [_Assumption(what, named(network.of_kind(kind), kind, name)) for name in wanted]
        return Situation(base, state, supposed)


class Situation:
    """A knowledge base as it would be if; made by `KnowledgeBase.situation`.

    Nothing is copied and the facts stay as they are. What the base learns later holds here too, under the same
    assumptions.
    """

    def __init__(self, base: Readable, state: State, assumptions: Iterable[_Assumption]) -> None:
        self._base = base
        self._network = state.network
        self._assumptions = tuple(assumptions)
        self._seen = (-1, -1)
        self._overlay: Overlay | None = None
        (
            self.actions,
            self.functions,
            self.components,
            self.designs,
            self.configurations,
            self.attributes,
        ) = views_of(self, self._network)

    is_feasible = questions.is_feasible
    selectable_actions = questions.selectable_actions
    selectable_designs = questions.selectable_designs
    selectable_configurations = questions.selectable_configurations
    best_configuration = questions.best_configuration
    adaptable_functions = questions.adaptable_functions
    adaptable_components = questions.adaptable_components
    obsolete = questions.obsolete
    explain = questions.explain
    why = questions.why
    explain_choice = questions.explain_choice
    situation = suppose

    @property
    def now(self) -> float:
        """The time by the clock [s]."""
        return self._base.now

    @contextmanager
    def reading(self) -> Iterator[State]:
        """Give the facts and statuses, to be read only; nothing changes within the `with` statement."""
        with self._base.reading() as below:
            seen = (below.version, self._network.revision)
            if self._overlay is None or self._seen != seen or not self._overlay.is_on(below):
                self._overlay, self._seen = self._supposed(below), seen
            yield self._overlay

    def __repr__(self) -> str:
        supposed = ", ".join(map(str, self._assumptions)) or "nothing else"
        with self.reading() as state:
            return f"<Situation of {self._network.model.name!r} with {supposed}: {questions.outline(state)}>"

    def _supposed(self, below: State) -> Overlay:
        state = Overlay(below)
        touched: list[Node] = []
        for what, node, value in self._assumptions:
            self._network.find(node.element)
            if what == "measured":
                touched += _suppose_measured(state, node, value)
                continue
            touched.append(node)
            if what == "requested":
                state.requested[node.index] = True
            else:
                state.failed[node.index] = what == "failed"
                if what == "recovered" and state.asserted[node.index] is Status.FAILURE:
                    state.asserted[node.index] = None
        propagate(state, touched)
        return state


def _suppose_measured(state: State, attribute: Node, value: float | None) -> list[Node]:
    """Enter a value, measured at no time; returns the constraints whose status it may change."""
    index, thresholds = attribute.index, state.network.thresholds(attribute)
    before, was_stale = state.value[index], state.stale[index]
    state.value[index], state.time[index], state.stale[index] = value, None, False
    for one in thresholds.steady:
        state.verdict[one.index] = _debounced(state, one, value)
    if before is None or value is None or was_stale:
        return attribute.constraints
    return [*thresholds.steady, *thresholds.crossed(before, value)]


def _debounced(state: State, node: Node, value: float | None) -> Status | None:
    """Return what a debounced constraint is once a value has been measured for long enough."""
    assert isinstance(node.element, Constraint)
    return None if value is None else verdict(node.element, [value], 1, state.verdict[node.index])


def _value(name: str, value: object) -> float | None:
    try:
        return None if value is None else finite_number(value)
    except InvalidValue as error:
        raise InvalidValue(f"{name} cannot be supposed to be {value!r}: {error}") from None
