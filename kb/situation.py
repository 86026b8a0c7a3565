"""What if? The same questions as those to a knowledge base, answered as if some facts were different."""

from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, NamedTuple

from kb.elements import Constraint, finite_number
from kb.exceptions import InvalidValue
from kb.history import History
from kb.inference import settle
from kb.network import Node
from kb.questions import Questions
from kb.state import Overlay, State
from kb.status import Status
from kb.steadiness import verdict

if TYPE_CHECKING:
    from kb.telling import Telling

__all__ = ["Situation"]


class _Assumption(NamedTuple):
    what: str
    node: Node
    value: float | bool | None


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
        self._seen = -1
        self._overlay: Overlay | None = None

    @property
    def _state(self) -> State:
        with self._lock:
            below = self._base._state
            if self._overlay is None or self._seen != below.visited:
                self._overlay = self._supposed(below)
                self._seen = below.visited
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
        more = assumptions(self, {**(measured or {}), **attributes}, failed, recovered, requested)
        return Situation(self._base, (*self._assumptions, *more))

    def _history_of(self, attribute: Node) -> History:
        return self._base._history_of(attribute)

    def _supposed(self, below: State) -> Overlay:
        state, now = Overlay(below), self._clock()
        for what, node, value in self._assumptions:
            self._network.find(node.element)
            if what == "measured":
                assert value is None or isinstance(value, float)
                state.value[node.index] = value
                state.time[node.index] = None if value is None else now
                state.stale[node.index] = False
                for one in self._network.thresholds(node).steady:
                    state.verdict[one.index] = _settled(state, one, value)
            elif what == "requested":
                state.requested[node.index] = True
            else:
                state.failed[node.index] = bool(value)
                if not value and state.asserted[node.index] is Status.FAILURE:
                    state.asserted[node.index] = None
        settle(state, (node for _, node, _ in self._assumptions))
        return state


def assumptions(
    asked: Questions,
    measured: Mapping[str, float | None],
    failed: Iterable[str],
    recovered: Iterable[str],
    requested: Iterable[str],
) -> list[_Assumption]:
    """Return what is to be supposed, with names and values checked."""
    supposed = [_Assumption("measured", asked.attributes.node(name), _value(name, measured[name])) for name in measured]
    for what, value, names, views in (
        ("failed", True, failed, asked.components),
        ("failed", False, recovered, asked.components),
        ("requested", True, requested, asked.actions),
    ):
        listed = (names,) if isinstance(names, str) else names
        supposed += [_Assumption(what, views.node(name), value) for name in listed]
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
