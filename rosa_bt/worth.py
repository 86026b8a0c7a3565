"""What to do next, and how to be configured for it, by what that is worth until a deadline.

A mission states what actions gain, and which errands, such as refuelling, gain nothing but keep the others feasible. A
dynamic program finds the best course, exactly on a grid of times, by what the knowledge base forecasts. That an errand
is worth doing now is told to it: what is put off is asserted to be unfeasible, with the reason, so that every task
layer, explanation and replay follows. Nothing becomes feasible by it.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from math import ceil, inf
from typing import NamedTuple

from py_trees.behaviour import Behaviour
from py_trees.composites import Selector

from kb import KnowledgeBase, Status
from kb.elements import finite_number
from kb.exceptions import InvalidValue
from kb.manager import PriorityPlanner
from kb.planners import Choice
from kb.status import OPERATORS
from kb.views import ConstraintView
from rosa_bt.idioms import feasible_then_act

# In how many steps a horizon is looked at, how short one is at least [s]; with more states they are twice as long.
_STEPS, _FINEST_S, _MOST_STATES = 48, 1.0, 250
# Over how long it is asked how fast an attribute changes [s].
_SLOPE_S = 30.0
_NOISE, _ROUNDING = 1e-9, 1e-5
_LEAST = (">=", ">")


@dataclass(frozen=True, slots=True)
class Gain:
    """What doing an action is worth while it is feasible.

    Attributes:
        action: its name.
        rate: worth per second; by name of the configuration that it is done in, where it hangs on that.
        spread: by what share the rate may be higher or lower.
        away: how fast doing it takes the robot away from where errands are done [m/s].
        switching_s: for how long nothing is gained when the configuration changes [s].
    """

    action: str
    rate: float | Mapping[str, float]
    spread: float = 0.0
    away: float = 0.0
    switching_s: float = 0.0


@dataclass(frozen=True, slots=True)
class Errand:
    """An action that gains nothing, and restores attributes of which others need enough.

    Attributes:
        action: its name.
        restores: what the attributes are when it is done, by name.
        there, back: how long that takes, and how long it then takes until work goes on, by how far away it is [m to s].
        spread: by what share both may be longer or shorter.
    """

    action: str
    restores: Mapping[str, float]
    there: Callable[[float], float]
    back: Callable[[float], float]
    spread: float = 0.0


@dataclass(frozen=True, slots=True)
class Worth:
    """What a mission is worth.

    Attributes:
        deadline: when it ends [s, by the clock of the knowledge base].
        gains: what is worth something.
        errands: what makes it last.
        keep: of which attributes enough is kept at every moment to have so much left at the end of an errand, by name.
            Of others an errand is planned only if their least value in the model is left.
        away: how far the robot is from where errands are done [m].
        unit: of the worth.
    """

    deadline: float
    gains: Sequence[Gain] = ()
    errands: Sequence[Errand] = ()
    keep: Mapping[str, float] = field(default_factory=dict)
    away: float = 0.0
    unit: str = ""


class Decision(NamedTuple):
    """What to do now.

    Attributes:
        action: its name; None for what is feasible, in the order of the task layer, as with nothing stated.
        configuration: what to be configured as for it; None if that is open.
        worth: what is expected to be gained from now until the deadline; None for "do not know".
        low, high: the same if all goes as badly, or as well, as is forecast and stated.
        reason: why, in a sentence.
        errands: when which begin by this plan [s].
    """

    action: str | None = None
    configuration: str | None = None
    worth: float | None = None
    low: float | None = None
    high: float | None = None
    reason: str = ""
    errands: tuple[tuple[float, str], ...] = ()


class Lookahead:
    """Decides what to do next, and tells the knowledge base what is put off.

    Args:
        kb: the knowledge base; its forecasts say how attributes go on.
        worth: what the mission is worth, or what says that at each decision; None, or no gains, for nothing stated.
        period: how often it is decided anew at most, while no status changes [s].

    Attributes:
        latest: what was decided last.

    Raises:
        UnknownName: the model has no such action, configuration or attribute.
        InvalidValue: a number that makes no sense.
    """

    def __init__(
        self, kb: KnowledgeBase, worth: Worth | Callable[[], Worth] | None = None, period: float = 1.0
    ) -> None:
        self._kb, self._given, self._period = kb, worth, period
        self.latest = Decision()
        self._asked: tuple[int, float] = -1, -inf
        self._begun: tuple[Errand, float, list[str]] | None = None
        self._worth = self._stated()

    def update(self) -> Decision:
        """Decide if it is time to, tell what is put off, and return what was decided last."""
        kb, (revision, time) = self._kb, self._asked
        if self._begun is not None:
            errand, until, put_off = self._begun
            is_done = all((kb.attributes[name].value or 0.0) >= 0.95 * full for name, full in errand.restores.items())
            if kb.now < until and kb.is_feasible(errand.action) and not is_done:
                return self.latest
            self._begun = None
            for action in [kb.actions[name] for name in put_off if name in kb.actions]:
                if self.latest.reason in kb.why(action):  # what somebody else has said meanwhile stands
                    kb.retract_status(action)
        elif kb.revision == revision and kb.now < time + self._period:
            return self.latest
        self.latest = self.decide()
        errands = [one for one in self._worth.errands if one.action == self.latest.action]
        if errands:
            self._put_off(errands[0])
        self._asked = kb.revision, kb.now
        return self.latest

    def decide(self) -> Decision:
        """Return what is best now; nothing is told."""
        kb, worth = self._kb, self._stated()
        self._worth = worth
        if not worth.gains or kb.now >= worth.deadline:
            return Decision()
        steps = min(_STEPS, ceil((worth.deadline - kb.now) / _FINEST_S))
        while True:
            question = _Question(kb, worth, steps)
            if question.unknown:
                return Decision(reason=f"as without looking ahead, since {question.unknown}")
            try:
                return question.decision()
            except _TooManyStates:
                steps = ceil(steps / 2)

    def _stated(self) -> Worth:
        worth = (self._given() if callable(self._given) else self._given) or Worth(inf)
        if worth.gains:
            _check(self._kb, worth)
        return worth

    def _put_off(self, errand: Errand) -> None:
        """Put off what an errand interrupts, until it is done, or should long have been."""
        kb, away = self._kb, self._worth.away
        until = kb.now + 2 * (errand.there(away) + errand.back(away)) + self._period
        names = [one.action for one in self._worth.gains if kb.is_feasible(one.action)]
        for name in names:
            kb.assert_status(kb.actions[name], Status.UNFEASIBLE, self.latest.reason, until)
        self._begun = errand, until, names


class WhatNext(Selector):
    """Does the first of several tasks that is feasible, with what is not worth doing now put off.

    Args:
        lookahead: decides, when it is time to.
        tasks: actions, trees that fail when what they do becomes unfeasible, or a plan executor; as in
            `first_feasible`, which this is with nothing stated.
    """

    def __init__(self, name: str, lookahead: Lookahead, tasks: Sequence[Behaviour]) -> None:
        super().__init__(name, memory=False, children=[feasible_then_act(task) for task in tasks])
        self.lookahead = lookahead

    def tick(self) -> Iterator[Behaviour]:
        self.feedback_message = self.lookahead.update().reason
        yield from super().tick()


class WorthPlanner(PriorityPlanner):
    """Chooses the configuration that a lookahead has decided for, and all else by priority."""

    def __init__(self, lookahead: Lookahead) -> None:
        self._lookahead = lookahead

    def choose(self, kb: KnowledgeBase) -> Choice | None:
        """Choose as `PriorityPlanner` does, but for what was decided."""
        choice = super().choose(kb)
        decision = self._lookahead.update()
        if choice is None or decision.configuration is None:
            return choice
        wanted = kb.configurations[decision.configuration]
        by_priority = choice.configurations.get(wanted.component, wanted.name)
        if by_priority == wanted.name or wanted.status is Status.UNFEASIBLE:
            return choice
        return Choice(choice.designs, {**choice.configurations, wanted.component: wanted.name}, decision.reason)


def _check(kb: KnowledgeBase, worth: Worth) -> None:
    """Raise for names that the model does not have, and numbers that make no sense."""
    finite_number(worth.deadline)
    for action, spread in [(one.action, one.spread) for group in (worth.gains, worth.errands) for one in group]:
        kb.is_feasible(action)
        if not 0.0 <= finite_number(spread) < 1.0:
            raise InvalidValue(f"the spread of {action} is a share from 0 to below 1, not {spread!r}")
    for attribute in (*worth.keep, *(name for errand in worth.errands for name in errand.restores)):
        kb.attributes[attribute]
    for action, (name, rate) in [(gain.action, one) for gain in worth.gains for one in _rates(gain)]:
        if finite_number(rate) < 0.0 or (name and not kb.configurations[name]):
            raise InvalidValue(f"what {action} gains in a second is 0 or more, not {rate!r}")


def _rates(gain: Gain) -> list[tuple[str, float]]:
    return list(gain.rate.items()) if isinstance(gain.rate, Mapping) else [("", gain.rate)]


_Levels = tuple[float, ...]


_Slopes = list[tuple[float, ...]]
"""How fast each level changes [1/s]: at the low end of the interval, as expected, at the high end."""


class _Way(NamedTuple):
    """Doing an action in a configuration: what it gains by side and step, how levels change and must be."""

    gain: Gain
    configuration: str
    rates: list[list[float]]
    slopes: _Slopes
    least: list[float]


class _TooManyStates(Exception):
    """A question has more states than are looked at."""


class _Course(NamedTuple):
    """What a solution comes to: the first move, what is gained, which errands begin when, when it stands still [s]."""

    first: int
    worth: float
    errands: tuple[tuple[float, str], ...]
    still: float | None

    @property
    def tail(self) -> str:
        if self.still is not None:
            return f"it would stand still from {self.still:.0f} s"
        return f"it leaves again at {self.errands[1][0]:.0f} s" if self.errands[1:] else "that lasts to the end"


_State = tuple[float, float, _Levels, int]
"""How much time is left [s], how far away the robot is [m], the levels, the way in which it works; -1 for none."""


class _Question:
    """One decision: numbers, and the dynamic program over them.

    A move is the number of a way or, beyond these, of an errand; -1 is to wait. Levels are the attributes that errands
    restore, more being better. All but the arrival at an errand is reckoned at one side: as expected (0), as badly (-1)
    or as well (1) as is forecast and stated.
    """

    def __init__(self, kb: KnowledgeBase, worth: Worth, steps: int) -> None:
        self._kb, self._worth, self._steps, self._left = kb, worth, steps, worth.deadline - kb.now
        self._h = self._left / steps
        self._names = list(dict.fromkeys(name for errand in worth.errands for name in errand.restores))
        values = {name: kb.attributes[name].value for name in self._names}
        unmeasured = [f"{name} is not measured" for name, value in values.items() if value is None]
        self.unknown = unmeasured[0] if unmeasured else ""
        self._levels = tuple(value or 0.0 for value in values.values())
        self._errands = [one for one in worth.errands if kb.is_feasible(one.action)]
        self._errand_slopes = [self._slopes(one.action) for one in self._errands]
        self._idle = self._slopes("")
        self._keep = [worth.keep.get(name, kb.model.attributes[name].low) for name in self._names]
        self._kept = [index for index, name in enumerate(self._names) if name in worth.keep]
        self._ways = [way for gain in worth.gains for way in self._ways_of(gain)]

    def _slopes(self, action: str) -> _Slopes:
        """Return how fast levels change while an action is done."""
        slopes: _Slopes = []
        for name, level in zip(self._names, self._levels, strict=True):
            element, span, doing = self._kb.model.attributes[name], _SLOPE_S, (action,) if action else ()
            now = self._kb.forecast(name, 0.0, doing=doing).value  # the level is as old as its measurement
            level = level if now is None else now
            ahead = self._kb.forecast(name, span, doing=doing)
            while ahead.value in (element.low, element.high) and span > 0.01:  # at the end of its range it stays
                span /= 2
                ahead = self._kb.forecast(name, span, doing=doing)
            self.unknown = self.unknown or (ahead.reason if ahead.value is None else "")
            ends = [ahead.value if end is None else end for end in (ahead.low, ahead.value, ahead.high)]
            slopes.append(tuple([0.0 if end is None else (end - level) / span for end in ends]))
        return slopes

    def _ways_of(self, gain: Gain) -> Iterator[_Way]:
        kb, action, names = self._kb, self._kb.actions[gain.action], self._names
        is_low = any(one.attribute in names and one.status is Status.VIOLATED for one in action.constraints)
        if not is_low and not kb.is_feasible(gain.action):
            return  # nothing says when what is missing comes back
        slopes = self._slopes(gain.action)
        for name, rate in _rates(gain):
            constraints = (*action.constraints, *(kb.configurations[name].constraints if name else ()))
            needed = [one for one in constraints if one.attribute in names and one.operator in _LEAST]
            least = [max([one.value for one in needed if one.attribute == each], default=-inf) for each in names]
            held = [[(True,) * 3] * self._steps, *(self._holding(one) for one in constraints if one not in needed)]
            rates = [[rate * all(mask[side] for mask in now) for now in zip(*held, strict=True)] for side in range(3)]
            yield _Way(gain, name, rates, slopes, least)

    def _holding(self, constraint: ConstraintView) -> list[tuple[bool, ...]]:
        """Return in which steps a constraint holds, by side; as it does now where that is unknown."""
        found: list[tuple[bool, ...]] = [(constraint.status is not Status.VIOLATED,) * 3]
        compare = OPERATORS[constraint.operator]
        for step in range(1, self._steps):
            ahead = self._kb.forecast(constraint.attribute, step * self._h)
            if ahead.value is None:
                return found[:1] * self._steps
            ends = [ahead.value if end is None else end for end in (ahead.low, ahead.value, ahead.high)]
            ends = ends if constraint.operator in _LEAST else ends[::-1]
            found.append(tuple([compare(end, constraint.value) for end in ends]))
        return found

    def _solved(self, side: int, *, is_late: bool = False) -> _Course:
        """Find the best course; if late, errands are begun only when nothing else can be done."""
        self._side, self._is_late = side, is_late
        self._known: dict[_State, tuple[float, int]] = {}
        self._rates = [[rate * (1 + side * way.gain.spread) for rate in way.rates[1 + side]] for way in self._ways]
        self._top = max(map(max, self._rates))
        self._free = self._without_levels()
        kb, doing = self._kb, -1
        for number, (gain, name, *_) in enumerate(self._ways):
            if kb.actions[gain.action].is_required and (not name or kb.configurations[name].is_selected):
                doing = number
        start = state = round(self._left, 6), round(self._worth.away, 3), self._levels, doing
        errands, still = list[tuple[float, str]](), None
        while state[0] > _ROUNDING:
            move, time = self._best(state)[1], self._worth.deadline - state[0]
            if move >= len(self._ways):
                errands.append((time, self._errands[move - len(self._ways)].action))
            still = None if move >= 0 else time if still is None else still
            state = self._after(state, move) or state
        worth, first = self._best(start)
        return _Course(first, worth, tuple(errands), still)

    def _without_levels(self) -> list[list[tuple[float, int]]]:
        """Return what is gained from each step on, and by which move, were levels no matter; by the way before."""
        free = [[(0.0, -1)] * (len(self._ways) + 1)]
        for step in range(self._steps - 1, -1, -1):
            row, possible = [], [number for number, rates in enumerate(self._rates) if rates[step]]
            for before in (*range(len(self._ways)), -1):
                moves = [(self._worked(before, one, step, self._h) + free[-1][one][0], one) for one in possible]
                row.append(max(moves, default=(free[-1][before][0], -1)))
            free.append(row)
        return free[::-1]

    def _worked(self, before: int, way: int, step: int, time: float) -> float:
        """Return what working in a way for a time gains, less what it takes to change to it."""
        gain, rate = self._ways[way].gain, self._rates[way][step]
        is_switched = before not in (way, -1) and self._ways[before].gain is gain
        return rate * (time - gain.switching_s * is_switched)

    def _freely(self, left: float, before: int) -> tuple[float, int]:
        """Return what is gained in the time that is left, and by which move, were levels no matter."""
        step = self._step(left)
        (value, move), (later, _) = self._free[step][before], self._free[step + 1][before]
        return later + (value - later) * (left / self._h - (self._steps - step - 1)), move

    def _best(self, state: _State) -> tuple[float, int]:
        """Return what can be gained from a state on, and by which move."""
        known = self._known.get(state)
        if known is None:
            if len(self._known) >= _MOST_STATES:
                raise _TooManyStates
            known = self._known[state] = self._worked_out(state)
        return known

    def _worked_out(self, state: _State) -> tuple[float, int]:
        left, _, levels, before = state
        if left <= _ROUNDING:
            return 0.0, -1
        if not self._kept and all(self._lasting(levels, way) >= left - _ROUNDING for way in self._ways):
            return self._freely(left, before)
        best, move = -inf, -1
        for number in range(len(self._ways) + len(self._errands)):
            if self._is_late and number >= len(self._ways) and move >= 0:
                break
            after = self._after(state, number)
            if after is not None:
                is_way = number < len(self._ways)
                now = self._worked(before, number, self._step(left), left - after[0]) if is_way else 0.0
                value = now + self._bound(after)
                if value > best + _NOISE and (value := now + self._best(after)[0]) > best + _NOISE:
                    best, move = value, number
        return (best, move) if move >= 0 else (self._best(self._after(state, -1) or state)[0], -1)

    def _after(self, state: _State, move: int) -> _State | None:
        """Return the state that a move leads to; None if it must not be made, which waiting may always."""
        left, away, levels, before = state
        time = min(self._h, left)
        if move < 0:
            return round(left - time, 6), away, self._worn(levels, self._idle, time), before
        if move < len(self._ways):
            way = self._ways[move]
            if not self._rates[move][self._step(left)] or self._lasting(levels, way) < 0.999 * time:
                return None
            levels, away = self._worn(levels, way.slopes, time), round(max(0.0, away + way.gain.away * time), 3)
            arriving = (self._arrives(levels, away, one, self._kept) for one in range(len(self._errands)))
            return (round(left - time, 6), away, levels, move) if not self._kept or any(arriving) else None
        number = move - len(self._ways)
        there, back = self._takes(number, away)
        is_left = self._is_late or self._arrives(levels, away, number, range(len(self._names)))
        if there >= left or not is_left:
            return None
        arrived = zip(self._names, self._worn(levels, self._errand_slopes[number], there), strict=True)
        restored = tuple([self._errands[number].restores.get(name, level) for name, level in arrived])
        left = round(max(0.0, left - max(there + back, _FINEST_S)), 6)
        return left, away, self._worn(restored, self._errand_slopes[number], back), -1

    def _step(self, left: float) -> int:
        return min(int(self._steps - left / self._h + _ROUNDING), self._steps - 1)

    def _bound(self, state: _State) -> float:
        """Return what no course from a state gains more than: it stands still at the end, or does one more errand."""
        left, away, levels, before = state
        free = self._freely(left, before)[0]
        lasting = max([self._lasting(levels, way) for way in self._ways])
        if lasting >= left or not self._errands:
            return free
        nearest = max(0.0, away + left * min([0.0, *(way.gain.away for way in self._ways)]))
        takes = min(sum(self._takes(number, nearest)) for number in range(len(self._errands)))
        return min(free, self._top * max(lasting, left - takes))

    def _takes(self, errand: int, away: float) -> tuple[float, float]:
        one, share = self._errands[errand], 1 - self._side * self._errands[errand].spread
        return one.there(away) * share, one.back(away) * share

    def _lasting(self, levels: _Levels, way: _Way) -> float:
        """Return for how long levels suffice for a way to work [s]."""
        lasting = inf
        for level, slope, least in zip(levels, way.slopes, way.least, strict=True):
            if level < least - _ROUNDING:
                return -1.0
            if slope[1 + self._side] < 0.0:
                lasting = min(lasting, (level - least) / -slope[1 + self._side])
        return lasting

    def _worn(self, levels: _Levels, slopes: _Slopes, time: float) -> _Levels:
        pairs = zip(levels, slopes, strict=True)
        return tuple([round(level + slope[1 + self._side] * time, 6) for level, slope in pairs])

    def _arrives(self, levels: _Levels, away: float, errand: int, which: Sequence[int]) -> bool:
        """Tell whether enough is left at the end of an errand, at the worse ends."""
        one, slopes = self._errands[errand], self._errand_slopes[errand]
        takes = one.there(away) * (1 + one.spread)
        return all(levels[index] + slopes[index][0] * takes >= self._keep[index] for index in which)

    def decision(self) -> Decision:
        """Return what is best now, with what is expected to come of it."""
        if not self._ways:
            return Decision(reason="as without looking ahead, since nothing can be gained")
        worst, best, course = self._solved(-1), self._solved(1), self._solved(0)
        numbers, unit = (course.worth, worst.worth, best.worth), f" {self._worth.unit}" if self._worth.unit else ""
        expected = f"{course.worth:.3g}{unit} ({worst.worth:.3g} to {best.worth:.3g})"
        if course.first >= len(self._ways):
            late = self._solved(0, is_late=True)
            when = f"leaving at {late.errands[0][0]:.0f} s, when it has to, " if late.errands else "not leaving "
            action, now = self._errands[course.first - len(self._ways)].action, self._worth.deadline - self._left
            reason = f"{action} now: leaving at {now:.0f} s {course.tail} and gains {expected}; "
            reason += f"{when}{late.tail} and gains {late.worth:.3g}{unit}"
            return Decision(action, None, *numbers, reason, course.errands)
        later = "".join(f"; {errand} at {time:.0f} s" for time, errand in course.errands)
        doing, name, *_ = self._ways[course.first] if course.first >= 0 else (None, "")
        what = " in ".join(filter(None, (doing.action if doing else "waiting", name)))
        reason = f"{what} now: that gains {expected}{later}"
        return Decision(doing.action if doing else None, name or None, *numbers, reason, course.errands)
