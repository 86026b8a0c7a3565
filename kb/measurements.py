"""Measurements, and what follows from them with time: histories, ageing, and constraints that do not flap.

A constraint can be debounced by hysteresis, by dwell, and by n of the last k measurements; by default it is not, as in
ROSA. The status of a debounced constraint depends on earlier measurements, so it is stored as a fact, its verdict,
which inference reads.
"""

import heapq
import math
from collections.abc import Iterable
from typing import NamedTuple

from kb.elements import Constraint
from kb.network import Node, is_steady
from kb.records import Memory
from kb.state import History, State
from kb.status import OPERATORS, Status


class Alarms:
    """When to look again: at most one alarm for each key, at a time of the clock."""

    __slots__ = ("_queue", "_times", "next")

    def __init__(self) -> None:
        self._queue: list[tuple[float, int]] = []
        self._times: dict[int, float] = {}
        self.next = math.inf

    def set(self, key: int, time: float) -> None:
        """Set the alarm of a key [s], in place of the one that it has; it can be repeated."""
        before = self._times.get(key)
        self._times[key] = time
        if (
            before is None or time <= before
        ):  # one that is put off is found when it would have been due
            heapq.heappush(self._queue, (time, key))
            self.next = self._queue[0][0]

    def clear(self, key: int) -> None:
        self._times.pop(key, None)

    def due(self, now: float) -> tuple[float, int] | None:
        """Return the time and key of the first alarm that is due, if one is; it stays until it is taken back."""
        queue = self._queue
        while queue and queue[0][0] <= now:
            set_for, key = queue[0]
            time = self._times.get(key)
            if time == set_for:
                return time, key
            if time is None:
                heapq.heappop(queue)
            else:
                heapq.heapreplace(queue, (time, key))  # in one step, so that no alarm is lost
        self.next = queue[0][0] if queue else math.inf
        return None


class Judged(NamedTuple):
    """The new verdict of a debounced constraint, None for no change, and when to look again [s], None for never."""

    node: Node
    verdict: Status | None
    wait: float | None


class Measurements:
    """What is remembered of measurements beside the latest."""

    def __init__(self, state: State, memory: Memory) -> None:
        self._state, self._memory = state, memory
        self.alarms = Alarms()
        self.recent: dict[int, tuple[float, ...]] = {}
        self.since: dict[int, float] = {}

    def history(self, attribute: Node) -> History:
        found = self._state.histories.get(attribute.index)
        if found is None:
            found = self._state.histories[attribute.index] = History(self._memory)
        return found

    def with_latest(self, attribute: Node, value: float) -> tuple[float, ...]:
        """Return the measurements that count, with a new one."""
        return (*self.recent.get(attribute.index, ()), value)[-attribute.attribute.agreement[1] :]

    def put(
        self,
        attribute: Node,
        value: float,
        time: float,
        history: History,
        count: int,
        recent: tuple[float, ...],
    ) -> None:
        """Make a measurement the latest; it may be done again."""
        index, state, element = attribute.index, self._state, attribute.element
        state.value[index], state.time[index], state.stale[index] = value, time, False
        if recent:
            self.recent[index] = recent
        if element.max_age != math.inf:
            self._expire(attribute, time)
        history.add(time, value, count)

    def _expire(self, attribute: Node, measured: float) -> None:
        max_age: float = attribute.element.max_age
        if max_age != math.inf:
            self.alarms.set(attribute.index, math.nextafter(measured + max_age, math.inf))

    def put_judged(self, judged: Iterable[Judged], now: float) -> None:
        """Remember since when debounced constraints have their verdict, and when to look again; it can be repeated."""
        for node, after, wait in judged:
            if after is not None:
                self.since[node.index] = now
            if wait is None:
                self.alarms.clear(node.index)
            else:
                self.alarms.set(node.index, wait)

    def put_stale(self, attribute: Node) -> None:
        """Forget what no longer counts once a measurement is too old; it may be done again."""
        self.recent.pop(attribute.index, None)
        self.alarms.clear(attribute.index)

    def judge(
        self,
        node: Node,
        value: float | None,
        recent: tuple[float, ...],
        before: Status | None,
        now: float,
    ) -> Judged:
        constraint, attribute = node.constraint, node.attribute
        if value is None:
            return Judged(node, None, None)
        enough, last = attribute.agreement
        known = None if before is Status.NOT_EVALUATED else before
        after = (
            verdict(constraint, recent if last > 1 else (value,), enough, known)
            or Status.NOT_EVALUATED
        )
        if after is before:
            return Judged(node, None, None)
        end = self.since.get(node.index, -math.inf) + constraint.dwell
        return (
            Judged(node, None, end)
            if known is not None and now < end
            else Judged(node, after, None)
        )

    def renew(self, node: Node, now: float) -> None:
        if node.kind == "constraint":
            self._begin(node, now)
            return
        element, time, index = node.attribute, self._state.time[node.index], node.index
        self._state.stale[index] = False
        self.put_stale(node)
        value = self._state.value[index]
        if element.agreement != (1, 1) and value is not None:
            self.recent[index] = (value,)
        if time is not None:
            self._expire(node, time)
        for constraint in node.constraints:
            self._begin(constraint, now)

    def resume(self, attribute: Node, now: float) -> None:
        measured, value = self._state.time[attribute.index], self._state.value[attribute.index]
        if measured is not None and not self._state.stale[attribute.index]:
            self._expire(attribute, measured)
        recent = self.recent.get(attribute.index, ())
        steady = [one for one in attribute.constraints if is_steady(one)]
        judged = [
            self.judge(one, value, recent, self._state.verdict[one.index], now) for one in steady
        ]
        self.put_judged([Judged(node, None, wait) for node, _, wait in judged], now)

    def _begin(self, node: Node, now: float) -> None:
        self.alarms.clear(node.index)
        self.since.pop(node.index, None)
        self._state.verdict[node.index] = None
        if is_steady(node):
            attribute = node.parts[0].index
            judged = self.judge(
                node, self._state.value[attribute], self.recent.get(attribute, ()), None, now
            )
            self._state.verdict[node.index] = judged.verdict
            self.put_judged([judged], now)


def verdict(
    constraint: Constraint, values: Iterable[float], enough: int, before: Status | None
) -> Status | None:
    """Return the status of a constraint by the latest measurements that count, without its dwell.

    It stays what it was before (None if neither satisfied nor violated) unless enough of them say otherwise.
    """
    votes = [_side(constraint, value, before) for value in values]
    agreed = [
        status for status in (Status.SATISFIED, Status.VIOLATED) if votes.count(status) >= enough
    ]
    return agreed[0] if agreed else before


def _side(constraint: Constraint, value: float, before: Status | None) -> Status:
    """Return on which side of the threshold a value is; for one that was violated it lies further off."""
    is_so = OPERATORS[constraint.operator](value, turning_point(constraint, before))
    return Status.SATISFIED if is_so else Status.VIOLATED


def turning_point(constraint: Constraint, before: Status | None) -> float:
    """Return the value at which a constraint turns, after what it was, in the attribute's unit."""
    if before is not Status.VIOLATED or not constraint.hysteresis:
        return constraint.value
    sign = 1 if constraint.operator in (">=", ">") else -1
    return float(
        f"{constraint.value + sign * constraint.hysteresis:.15g}"
    )  # as on paper: 0.1 and 0.2 are 0.3
