"""What if? The same questions as those to a knowledge base, answered as if some facts were different."""

from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, NamedTuple

from kb.declarations import listed
from kb.elements import Constraint, exact, finite_number
from kb.exceptions import InvalidValue
from kb.history import History
from kb.inference.network import Node
from kb.inference.settling import settle
from kb.inference.state import Overlay, State
from kb.inference.steadiness import verdict
from kb.questions import Questions
from kb.status import Status

if TYPE_CHECKING:
    from kb.telling import Telling

__all__ = ["Situation", "assumptions", "told_of"]


class _Assumption(NamedTuple):
    what: str
    node: Node
    value: float | None = None

    def __str__(self) -> str:
        if self.what != "measured":
            return f"{self.node.name} {self.what}"
        return f"{self.node.name} {'not measured' if self.value is None else exact(self.value)}"


class Situation(Questions):
    """A knowledge base as it would be if; made by `KnowledgeBase.situation`.

    Nothing is copied and the facts stay as they are. What the base learns later holds here too, under the same
    assumptions.
    """

    def __init__(self, base: "Telling", assumptions: tuple[_Assumption, ...]) -> None:
        super().__init__(base._network, base._clock)
        self._base = base
        self._assumptions = assumptions
        self._lock, self._in_force = base._lock, base._in_force
        self._seen = (-1, -1)
        self._overlay: Overlay | None = None

    @property
    def _state(self) -> State:
        with self._lock:
            below = self._base._state
            seen = (below.visited, self._network.revision)
            if self._overlay is None or self._seen != seen:
                self._overlay = self._supposed(below)
                self._seen = seen
            return self._overlay

    def is_feasible(self, action: str) -> bool:
        """Tell whether an action could be done: its status would not be "unfeasible"."""
        with self._lock:
            return super().is_feasible(action)

    def situation(
        self,
        measured: Mapping[str, float | None] | None = None,
        /,
        *,
        failed: Iterable[str] = (),
        recovered: Iterable[str] = (),
        requested: Iterable[str] = (),
        **attributes: float | None,
    ) -> "Situation":
        """Return the situation in which more is different; what is said here goes before what was said there."""
        more = assumptions(self, measured, attributes, failed, recovered, requested)
        return Situation(self._base, (*self._assumptions, *more))

    def __repr__(self) -> str:
        supposed = ", ".join(map(str, self._assumptions)) or "nothing else"
        return f"<Situation of {self._network.model.name!r} with {supposed}: {told_of(self._state)}>"

    def _history_of(self, attribute: Node) -> History:
        return self._base._history_of(attribute)

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
        settle(state, touched)
        return state


def told_of(state: State) -> str:
    """Say in short what the actions of a state are."""
    actions = state.network.actions.values()
    feasible = sum(state.status[action.index] is not Status.UNFEASIBLE for action in actions)
    required = [action.name for action in actions if state.required[action.index]]
    told = f"{feasible} of {len(actions)} actions feasible"
    return f"{told}, required: {', '.join(required)}" if required else told


def _suppose_measured(state: State, attribute: Node, value: float | None) -> list[Node]:
    """Enter a value, measured at no time; returns the constraints whose status it may change."""
    index, thresholds = attribute.index, state.network.thresholds(attribute)
    before, was_stale = state.value[index], state.stale[index]
    state.value[index], state.time[index], state.stale[index] = value, None, False
    for one in thresholds.steady:
        state.verdict[one.index] = _settled(state, one, value)
    if before is None or value is None or was_stale:
        return attribute.constraints
    return [*thresholds.steady, *thresholds.crossed(before, value)]


def assumptions(
    asked: Questions,
    measured: Mapping[str, float | None] | None,
    attributes: Mapping[str, float | None],
    failed: Iterable[str],
    recovered: Iterable[str],
    requested: Iterable[str],
) -> list[_Assumption]:
    """Return what is to be supposed, with names and values checked."""
    if not isinstance(measured, Mapping | None):
        raise InvalidValue(f"what is supposed to be measured is given as values by name, not as {measured!r}")
    values = {**(measured or {}), **attributes}
    supposed = [_Assumption("measured", asked.attributes.node(name), _value(name, values[name])) for name in values]
    for what, names, views in (
        ("failed", failed, asked.components),
        ("recovered", recovered, asked.components),
        ("requested", requested, asked.actions),
    ):
        wanted = (names,) if isinstance(names, str) else listed(f"names supposed to be {what}", names)
        supposed += [_Assumption(what, views.node(name)) for name in wanted]
    return supposed


def _settled(state: State, node: Node, value: float | None) -> Status | None:
    """Return what a constraint that does not flap is once a value has been measured for long enough."""
    assert isinstance(node.element, Constraint)
    before = state.verdict[node.index]
    return None if value is None else verdict(node.element, [value], 1, before)


def _value(name: str, value: object) -> float | None:
    try:
        return None if value is None else finite_number(value)
    except InvalidValue as error:
        raise InvalidValue(f"{name} cannot be supposed to be {value!r}: {error}") from None
