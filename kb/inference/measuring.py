"""Measurements, and what follows from them with time: histories, ageing, and constraints that do not flap."""

import math
from collections import deque
from collections.abc import Iterator, Sequence
from typing import NamedTuple

from kb.elements import Attribute, Constraint
from kb.history import History
from kb.inference.alarms import Alarms
from kb.inference.network import Node, is_steady
from kb.inference.state import State
from kb.inference.steadiness import verdict
from kb.status import Status

__all__ = ["Late", "Measurements"]


class Late(NamedTuple):
    """Something that follows from time alone.

    Attributes:
        node: what it is about.
        text: what, in words.
        touched: the constraints from which to infer again.
    """

    node: Node
    text: str
    touched: Sequence[Node]


class Measurements:
    """Keeps the measurements of a state.

    Args:
        state: where the latest ones are entered, and what steady constraints make of them.
    """

    def __init__(self, state: State) -> None:
        self._state = state
        self._histories: dict[int, History] = {}
        self._alarms = Alarms()
        self._recent: dict[int, deque[float]] = {}
        self._since: dict[int, float] = {}

    @property
    def next_change(self) -> float:
        """Nothing follows from time alone before [s]."""
        return self._alarms.next

    def history_of(self, attribute: Node) -> History:
        """Return every measurement of an attribute."""
        history = self._histories.get(attribute.index)
        if history is None:
            history = self._histories[attribute.index] = History()
        return history

    def take(self, node: Node, value: float, time: float) -> Sequence[Node]:
        """Enter the latest measurement of an attribute; returns the constraints whose status it may change."""
        state, index = self._state, node.index
        before, was_stale = state.value[index], state.stale[index]
        state.value[index], state.time[index], state.stale[index] = value, time, False
        self.history_of(node).add(time, value)
        element = node.element
        assert isinstance(element, Attribute)
        if element.max_age != math.inf:
            self._alarms.set(index, _after(time + element.max_age))
        thresholds = state.network.thresholds(node)
        if element.agreement != (1, 1):
            self._recent.setdefault(index, deque(maxlen=element.agreement[1])).append(value)
        changed = [one for one in thresholds.steady if self._judge(one, time)]
        if before is None or was_stale:
            return node.constraints
        return [*changed, *thresholds.crossed(before, value)] if value != before else changed

    def due(self, now: float) -> Iterator[Late]:
        """Yield what has become so since somebody last looked."""
        for index in self._alarms.due(now):
            node = self._state.network.nodes[index]
            if node.kind == "constraint":
                if self._judge(node, now):
                    yield Late(node, f"{node.name} is {self._state.verdict[index]}, after its dwell", [node])
                continue
            element, time = node.element, self._state.time[index]
            assert isinstance(element, Attribute)
            if time is not None:
                self._state.stale[index] = True
                self._recent.pop(index, None)
                text = f"{node.name} is stale: measured {now - time:.1f} s ago, at most {element.max_age:g} s"
                yield Late(node, text, node.constraints)

    def renew(self, node: Node, now: float) -> Sequence[Node]:
        """Take note that an attribute or constraint is new or has changed; returns the constraints concerned."""
        if node.kind == "constraint":
            self._begin(node, now)
            return [node]
        element, time, index = node.element, self._state.time[node.index], node.index
        assert isinstance(element, Attribute)
        self._state.stale[index] = False
        self._alarms.clear(index)
        self._recent.pop(index, None)
        value = self._state.value[index]
        if element.agreement != (1, 1) and value is not None:
            self._recent[index] = deque([value], maxlen=element.agreement[1])
        if time is not None and element.max_age != math.inf:
            self._alarms.set(index, _after(time + element.max_age))
        for constraint in node.constraints:
            self._begin(constraint, now)
        return node.constraints

    def resume(self, constraint: Node, verdict: Status, since: float) -> None:
        """Take up what a steady constraint was after all that was measured before, and since when [s]."""
        self._state.verdict[constraint.index], self._since[constraint.index] = verdict, since
        time = self._state.time[constraint.parts[0].index]
        self._judge(constraint, since if time is None else time)

    def forget(self, node: Node) -> None:
        """Take note that an attribute or constraint is no longer in the model."""
        self._alarms.clear(node.index)

    def _begin(self, constraint: Node, now: float) -> None:
        """Judge a constraint as if nothing had been known of it before."""
        self._alarms.clear(constraint.index)
        self._since.pop(constraint.index, None)
        self._state.verdict[constraint.index] = None
        if is_steady(constraint):
            self._judge(constraint, now)

    def _judge(self, node: Node, now: float) -> bool:
        """Bring up to date what a steady constraint is; returns whether that changed."""
        index, constraint, attribute = node.index, node.element, node.parts[0]
        assert isinstance(constraint, Constraint)
        assert isinstance(attribute.element, Attribute)
        value, before = self._state.value[attribute.index], self._state.verdict[index]
        if value is None:
            return False
        enough, last = attribute.element.agreement
        values = self._recent.get(attribute.index, ()) if last > 1 else (value,)
        known = None if before is Status.NOT_EVALUATED else before
        after = verdict(constraint, values, enough, known) or Status.NOT_EVALUATED
        if after is before:
            self._alarms.clear(index)
            return False
        end = self._since.get(index, -math.inf) + constraint.dwell
        if known is not None and now < end:
            self._alarms.set(index, end)
            return False
        self._state.verdict[index], self._since[index] = after, now
        self._alarms.clear(index)
        return True


def _after(time: float) -> float:
    return math.nextafter(time, math.inf)
