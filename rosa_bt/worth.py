"""When to interrupt what gains something for a detour that keeps it feasible, such as refuelling.

A mission states what its actions gain and which detours there are. From the forecasts of the
knowledge base follows how long the levels last, so each time to leave has a value until the
deadline. If leaving now is worth most, the actions that the detour interrupts are put off: they are
asserted to be unfeasible, with the reason, so that every task layer, explanation and replay sees
it. No action becomes feasible in this way.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from math import inf
from typing import NamedTuple

from py_trees.behaviour import Behaviour
from py_trees.composites import Selector

from kb import KnowledgeBase, Status
from kb.elements import finite_number
from kb.exceptions import InvalidValue
from rosa_bt.composites import feasible_then_act

_TIMES = (24, 8, 4)
"""How many times to leave are compared for the first detour, the second and the third."""
_SLOPE_S = 30.0
"""Time over which the rate of change of an attribute is taken from its forecast [s]."""
_SIDES = (-1, 0, 1)
"""Everything at its worse end, as expected, at its better end."""


@dataclass(frozen=True, slots=True)
class Gain:
    """What an action gains while it is done.

    Attributes:
        action: its name.
        rate: value gained per second.
        spread: share by which the rate may be higher or lower, from 0 to below 1.
        away: speed at which the action takes the robot away from where detours lead [m/s].
    """

    action: str
    rate: float
    spread: float = 0.0
    away: float = 0.0


@dataclass(frozen=True, slots=True)
class Detour:
    """An action that gains nothing, but restores attributes that other actions need.

    Attributes:
        action: its name.
        restores: the values of attributes when it is done, by name.
        there, back: the time until that, and from then until work goes on [s], as functions of the
            distance [m].
        spread: share by which both times may be longer or shorter, from 0 to below 1.
    """

    action: str
    restores: Mapping[str, float]
    there: Callable[[float], float]
    back: Callable[[float], float]
    spread: float = 0.0


@dataclass(frozen=True, slots=True)
class MissionValue:
    """What a mission gains, and by when.

    Attributes:
        deadline: when the mission ends [s, by the clock of the knowledge base].
        gains: the actions that gain something; the one that gains most is done.
        detours: the actions that restore attributes.
        away: distance of the robot from where detours lead [m].
        unit: unit of the value, for messages.
    """

    deadline: float
    gains: Sequence[Gain] = ()
    detours: Sequence[Detour] = ()
    away: float = 0.0
    unit: str = ""


class Decision(NamedTuple):
    """What to do now.

    Attributes:
        action: the detour to make, or the action to go on with; None leaves the choice to the task
            layer.
        reason: why, in a sentence.
    """

    action: str | None = None
    reason: str = ""


class Lookahead:
    """Decides when to make a detour, and puts off the actions that it interrupts.

    Args:
        kb: the knowledge base; its forecasts say how attributes change.
        value: returns what the mission gains, for each decision.
        period: least time between two decisions while no status changes [s].

    Attributes:
        latest: the last decision.

    Raises:
        kb.UnknownName: the model has no such action or attribute.
        kb.InvalidValue: a number is not finite or out of its range.
    """

    def __init__(
        self,
        kb: KnowledgeBase,
        value: Callable[[], MissionValue],
        period: float = 1.0,
    ) -> None:
        self._kb = kb
        self._value = value
        self._period = period
        self.latest = Decision()
        self._decided_at: tuple[int, float] = -1, -inf
        self._detour: Detour | None = None
        self._until = -inf
        self._postponed: list[str] = []
        _check(kb, value())

    def update(self) -> Decision:
        """Decide if it is time to, and put off what a detour interrupts."""
        kb = self._kb
        revision, time = self._decided_at
        if self._detour is not None:
            if self._is_under_way(self._detour):
                return self.latest
            for name in self._postponed:  # unless somebody else has asserted something
                if name in kb.actions and self.latest.reason in kb.why(kb.actions[name]):
                    kb.retract_status(kb.actions[name])
            self._detour = None
        elif kb.revision == revision and kb.now < time + self._period:
            return self.latest
        value = self._value()
        _check(kb, value)
        self.latest = Decision()
        self._decided_at = kb.revision, kb.now
        gains = [gain for gain in value.gains if kb.is_feasible(gain.action)]
        if not gains or kb.now >= value.deadline:
            return self.latest
        gain = max(gains, key=lambda gain: gain.rate)
        self.latest = Decision(gain.action)
        for detour in value.detours:
            if kb.is_feasible(detour.action):
                self.latest = _Question(kb, value, gain, detour).decision()
                if self.latest.action == detour.action:
                    self._put_off(value, detour)
                    break
        return self.latest

    def _is_under_way(self, detour: Detour) -> bool:
        kb = self._kb
        if kb.now >= self._until or not kb.is_feasible(detour.action):
            return False
        full = detour.restores.items()
        return any((kb.attributes[name].value or 0.0) < 0.95 * value for name, value in full)

    def _put_off(self, value: MissionValue, detour: Detour) -> None:
        """Assert the gaining actions unfeasible, for at most twice the time of the detour."""
        kb = self._kb
        takes = detour.there(value.away) + detour.back(value.away)
        self._detour = detour
        self._until = kb.now + 2 * takes + self._period
        self._postponed = [gain.action for gain in value.gains if kb.is_feasible(gain.action)]
        for name in self._postponed:
            action = kb.actions[name]
            kb.assert_status(action, Status.UNFEASIBLE, self.latest.reason, self._until)


class ValueSelector(Selector):
    """Does the first of several tasks that is feasible; tasks that a detour interrupts are put off.

    Args:
        lookahead: decides when to make a detour; it is updated in each tick.
        tasks: actions, subtrees that fail when their action becomes unfeasible, or a plan executor.
            If nothing is stated, this does the same as `first_feasible`.
    """

    def __init__(self, name: str, lookahead: Lookahead, tasks: Sequence[Behaviour]) -> None:
        super().__init__(name, memory=False, children=[feasible_then_act(task) for task in tasks])
        self.lookahead = lookahead

    def tick(self) -> Iterator[Behaviour]:
        self.feedback_message = self.lookahead.update().reason
        yield from super().tick()


def _check(kb: KnowledgeBase, value: MissionValue) -> None:
    """Raise if the model does not have a name, or a number is not finite or out of its range."""
    if value.gains:
        finite_number(value.deadline)
    for detour in value.detours:
        kb.is_feasible(detour.action)
        for name in detour.restores:
            kb.attributes[name]
    for gain in value.gains:
        kb.is_feasible(gain.action)
        if finite_number(gain.rate) < 0.0:
            raise InvalidValue(f"what {gain.action} gains is 0 or more a second, not {gain.rate!r}")


class _Level(NamedTuple):
    """An attribute that a detour restores: its slopes by side [1/s], and its limits."""

    work: tuple[float, ...]
    detour: tuple[float, ...]
    full: float
    least: float
    low: float


class _State(NamedTuple):
    """The time until the deadline [s], the values of the attributes, and the distance [m]."""

    left: float
    levels: tuple[float, ...]
    away: float


class _Course(NamedTuple):
    """What is gained, and when the first detour begins [s from now]; None for none."""

    value: float
    leave: float | None = None


class _Question:
    """One decision: the value of each time to leave, on each side."""

    def __init__(self, kb: KnowledgeBase, value: MissionValue, gain: Gain, detour: Detour) -> None:
        self._gain = gain
        self._detour = detour
        self._value = value
        self._now = kb.now
        self._problem = ""
        self._levels: list[_Level] = []
        levels = []
        for name, full in detour.restores.items():
            least = max(
                [
                    constraint.value
                    for constraint in kb.actions[gain.action].constraints
                    if constraint.attribute == name and ">" in constraint.operator
                ],
                default=-inf,
            )
            work = self._slopes(kb, name, gain.action)
            change = self._slopes(kb, name, detour.action)
            low = kb.model.attributes[name].low
            self._levels.append(_Level(work, change, full, least, low))
            levels.append(kb.attributes[name].value or 0.0)
        self._state = _State(value.deadline - kb.now, tuple(levels), value.away)

    def _slopes(self, kb: KnowledgeBase, name: str, action: str) -> tuple[float, ...]:
        """Return how fast an attribute changes while an action is done, by side [1/s]."""
        element = kb.model.attributes[name]
        span = _SLOPE_S
        now = kb.forecast(name, 0.0, doing=(action,)).value
        ahead = kb.forecast(name, span, doing=(action,))
        while ahead.value in (element.low, element.high) and span > 0.01:  # at a limit it stops
            span /= 2
            ahead = kb.forecast(name, span, doing=(action,))
        if now is None or ahead.value is None:
            self._problem = self._problem or ahead.reason
            return (0.0, 0.0, 0.0)
        low = ahead.value if ahead.low is None else ahead.low
        high = ahead.value if ahead.high is None else ahead.high
        return tuple((end - now) / span for end in (low, ahead.value, high))

    def decision(self) -> Decision:
        """Return whether to leave now or to go on, with the reason."""
        if self._problem:
            return Decision(reason=f"as without looking ahead, since {self._problem}")
        state = self._state
        unit = f" {self._value.unit}".rstrip()
        low, course, high = (self._best(side, state) for side in _SIDES)
        expected = f"gains {course.value:.3g}{unit} ({low.value:.3g} to {high.value:.3g})"
        action = self._detour.action
        if course.leave == 0.0 and self._pays():
            last = f"leaving at {self._now + self._lasting(0, state):.0f} s, when it has to"
            gain = f"gains {self._late(0):.3g}{unit}"
            return Decision(
                action, f"{action} now: leaving at {self._now:.0f} s {expected}; {last}, {gain}"
            )
        later = f"; {action} at {self._now + course.leave:.0f} s" if course.leave else ""
        return Decision(self._gain.action, f"{self._gain.action} now: that {expected}{later}")

    def _pays(self) -> bool:
        """Tell whether leaving now gains more than leaving late, also at the worse end."""
        noise = self._gain.spread * self._gain.rate * sum(self._takes(0, self._state.away))
        for side, more in ((0, noise), (-1, -noise)):
            course = self._leaving(side, self._state, 0.0, 1)
            if course is None or course.value <= self._late(side) + more:
                return False
        return True

    def _late(self, side: int) -> float:
        """Return the value of leaving when the levels no longer allow to work, or never."""
        work = self._lasting(side, self._state)
        course = self._leaving(side, self._state, work, 1, is_forced=True)
        never = self._rate(side) * work
        return never if course is None else max(never, course.value)

    def _rate(self, side: int) -> float:
        return self._gain.rate * (1 + side * self._gain.spread)

    def _lasting(self, side: int, state: _State) -> float:
        """Return how long the levels suffice for work, at most until the deadline [s]."""
        lasting = state.left
        for level, value in zip(self._levels, state.levels, strict=True):
            slope = level.work[1 + side]
            if slope < 0.0:
                lasting = min(lasting, max(0.0, (value - level.least) / -slope))
        return lasting

    def _takes(self, side: int, away: float) -> tuple[float, float]:
        share = 1 - side * self._detour.spread
        return self._detour.there(away) * share, self._detour.back(away) * share

    def _away(self, state: _State, leave: float) -> float:
        return max(0.0, state.away + self._gain.away * leave)

    def _arrives(self, state: _State, leave: float) -> bool:
        """Tell whether enough of each level is left at the end of a detour, at the worst."""
        longest, _ = self._takes(-1, self._away(state, leave))
        for level, value in zip(self._levels, state.levels, strict=True):
            if value + level.work[0] * leave + level.detour[0] * longest < level.low:
                return False
        return True

    def _best(self, side: int, state: _State, depth: int = 0) -> _Course:
        """Return the best course: never leaving, or leaving at the best of some times."""
        work = self._lasting(side, state)
        best = _Course(self._rate(side) * work)
        if depth == len(_TIMES):
            return best
        count = _TIMES[depth]
        for number in range(count, -1, -1):
            course = self._leaving(side, state, work * number / count, depth + 1)
            if course is not None and course.value > best.value + 1e-9:
                best = course
        return best

    def _leaving(
        self, side: int, state: _State, leave: float, depth: int, *, is_forced: bool = False
    ) -> _Course | None:
        """Return the course that leaves at a time.

        None if it does not arrive, or arrives too late to gain anything.
        """
        distance = self._away(state, leave)
        there, back = self._takes(side, distance)
        left = state.left - leave - there - back
        if left <= 0.0 or not (is_forced or self._arrives(state, leave)):
            return None
        levels = [level.full + min(0.0, level.detour[1 + side]) * back for level in self._levels]
        following = self._best(side, _State(left, tuple(levels), distance), depth)
        return _Course(self._rate(side) * leave + following.value, leave)
