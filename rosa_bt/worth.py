"""What to do next, and in which configuration, to gain most until a deadline.

A mission states what actions gain, and which errands, such as refuelling, gain nothing but keep other actions feasible.
A dynamic program finds the course that gains most, exact on a grid of times, from the forecasts of the knowledge base.
If an errand is worth doing now, the actions that it interrupts are put off: they are asserted to be unfeasible, with
the reason, so that every task layer, explanation and replay sees it. No action becomes feasible in this way.
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
from kb.planning import Choice, PriorityPlanner
from kb.status import OPERATORS
from kb.views import ConstraintView
from rosa_bt.composites import feasible_then_act

# Steps until the deadline at most; shortest step [s]; states at most: if there are more, steps are twice as long.
_STEPS, _FINEST_S, _MOST_STATES = 48, 1.0, 250
# Time over which the rate of change of an attribute is taken from its forecast [s].
_SLOPE_S = 30.0
_NOISE, _ROUNDING = 1e-9, 1e-5
_LEAST = (">=", ">")


@dataclass(frozen=True, slots=True)
class Gain:
    """What an action gains while it is done.

    Attributes:
        action: its name.
        rate: worth gained per second; if it depends on the configuration, a mapping from the name of a configuration.
        spread: share by which the rate may be higher or lower, from 0 to below 1.
        away: speed at which the action takes the robot away from where errands are done [m/s].
        switching_s: time without gain when the configuration changes [s].
    """

    action: str
    rate: float | Mapping[str, float]
    spread: float = 0.0
    away: float = 0.0
    switching_s: float = 0.0


@dataclass(frozen=True, slots=True)
class Errand:
    """An action that gains nothing, but restores attributes that other actions need.

    Attributes:
        action: its name.
        restores: the values of attributes when the errand is done, by name.
        there, back: the time until that, and from then until work goes on [s], as functions of the distance [m].
        spread: share by which both times may be longer or shorter, from 0 to below 1.
    """

    action: str
    restores: Mapping[str, float]
    there: Callable[[float], float]
    back: Callable[[float], float]
    spread: float = 0.0


@dataclass(frozen=True, slots=True)
class Worth:
    """What a mission gains, and by when.

    Attributes:
        deadline: when the mission ends [s, by the clock of the knowledge base].
        gains: the actions that gain something.
        errands: the actions that restore attributes.
        keep: least values of attributes at the end of an errand, by name: work goes on only as long as an errand can
            still end with them. For other attributes, errands have to end with their least value in the model.
        away: distance of the robot from where errands are done [m].
        unit: unit of the worth, for messages.
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
        action: its name; None leaves the choice to the task layer, as without a lookahead.
        configuration: name of the configuration for it; None if any will do.
        worth: expected gain from now until the deadline; None if unknown.
        low, high: the gain if everything is at its worse, or better, end of what is forecast and stated.
        reason: why, in a sentence.
        errands: start [s] and action of each errand in this course.
    """

    action: str | None = None
    configuration: str | None = None
    worth: float | None = None
    low: float | None = None
    high: float | None = None
    reason: str = ""
    errands: tuple[tuple[float, str], ...] = ()


class Lookahead:
    """Decides what to do next, and puts off the actions that an errand interrupts.

    Args:
        kb: the knowledge base; its forecasts say how attributes change.
        worth: what the mission gains, or a function that returns it for each decision; None for nothing stated.
        period: least time between two decisions while no status changes [s].

    Attributes:
        latest: the last decision.

    Raises:
        kb.UnknownName: the model has no such action, configuration or attribute.
        kb.InvalidValue: a number is not finite or out of its range.
    """

    def __init__(
        self,
        kb: KnowledgeBase,
        worth: Worth | Callable[[], Worth] | None = None,
        period: float = 1.0,
    ) -> None:
        self._kb, self._given, self._period = kb, worth, period
        self.latest = Decision()
        self._asked: tuple[int, float] = -1, -inf
        self._begun: tuple[Errand, float, list[str]] | None = None
        self._worth = self._stated()

    def update(self) -> Decision:
        """Decide if it is time to, put off what an errand interrupts, and return the last decision."""
        kb, (revision, time) = self._kb, self._asked
        if self._begun is not None:
            errand, until, put_off = self._begun
            is_done = all(
                (kb.attributes[name].value or 0.0) >= 0.95 * full
                for name, full in errand.restores.items()
            )
            if kb.now < until and kb.is_feasible(errand.action) and not is_done:
                return self.latest
            self._begun = None
            for action in [kb.actions[name] for name in put_off if name in kb.actions]:
                if self.latest.reason in kb.why(
                    action
                ):  # what somebody else has asserted meanwhile stays
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
        """Return the best decision now, without telling the knowledge base anything."""
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
        """Assert that the gaining actions are unfeasible, for at most twice the time that the errand should take."""
        kb, away = self._kb, self._worth.away
        until = kb.now + 2 * (errand.there(away) + errand.back(away)) + self._period
        names = [one.action for one in self._worth.gains if kb.is_feasible(one.action)]
        for name in names:
            kb.assert_status(kb.actions[name], Status.UNFEASIBLE, self.latest.reason, until)
        self._begun = errand, until, names


class WhatNext(Selector):
    """Does the first of several tasks that is feasible; tasks that are not worth doing now are put off.

    Args:
        lookahead: decides what to do; it is updated in each tick.
        tasks: actions, subtrees that fail when their action becomes unfeasible, or a plan executor. If nothing is
            stated, this does the same as `first_feasible`.
    """

    def __init__(self, name: str, lookahead: Lookahead, tasks: Sequence[Behaviour]) -> None:
        super().__init__(name, memory=False, children=[feasible_then_act(task) for task in tasks])
        self.lookahead = lookahead

    def tick(self) -> Iterator[Behaviour]:
        self.feedback_message = self.lookahead.update().reason
        yield from super().tick()


class WorthPlanner(PriorityPlanner):
    """Chooses the configuration that a lookahead decided on, and all others by priority."""

    def __init__(self, lookahead: Lookahead) -> None:
        self._lookahead = lookahead

    def choose(self, kb: KnowledgeBase) -> Choice | None:
        """Choose as `PriorityPlanner` does, except for the configuration that was decided on, if it is feasible."""
        choice = super().choose(kb)
        decision = self._lookahead.update()
        if choice is None or decision.configuration is None:
            return choice
        wanted = kb.configurations[decision.configuration]
        by_priority = choice.configurations.get(wanted.component, wanted.name)
        if by_priority == wanted.name or wanted.status is Status.UNFEASIBLE:
            return choice
        return Choice(
            choice.designs,
            {**choice.configurations, wanted.component: wanted.name},
            decision.reason,
        )


def _check(kb: KnowledgeBase, worth: Worth) -> None:
    """Raise if the model does not have a name, or a number is not finite or out of its range."""
    finite_number(worth.deadline)
    for action, spread in [
        (one.action, one.spread) for group in (worth.gains, worth.errands) for one in group
    ]:
        kb.is_feasible(action)
        if not 0.0 <= finite_number(spread) < 1.0:
            raise InvalidValue(
                f"the spread of {action} is a share from 0 to below 1, not {spread!r}"
            )
    for attribute in (*worth.keep, *(name for errand in worth.errands for name in errand.restores)):
        kb.attributes[attribute]
    for action, (name, rate) in [
        (gain.action, one) for gain in worth.gains for one in _rates(gain)
    ]:
        if finite_number(rate) < 0.0 or (name and not kb.configurations[name]):
            raise InvalidValue(f"what {action} gains in a second is 0 or more, not {rate!r}")


def _rates(gain: Gain) -> list[tuple[str, float]]:
    return list(gain.rate.items()) if isinstance(gain.rate, Mapping) else [("", gain.rate)]


_Levels = tuple[float, ...]

_Slopes = list[tuple[float, ...]]
"""Rate of change of each level [1/s]: at the low end of the interval, as expected, at the high end."""


class _Way(NamedTuple):
    """An action in a configuration: its rates by side and step, how levels change, and their least values."""

    gain: Gain
    configuration: str
    rates: list[list[float]]
    slopes: _Slopes
    least: list[float]


class _TooManyStates(Exception):
    """The dynamic program has more states than it may look at."""


class _Course(NamedTuple):
    """A solution: first move, gain, start [s] and action of each errand, when it stands still for good [s]."""

    first: int
    worth: float
    errands: tuple[tuple[float, str], ...]
    still: float | None

    @property
    def tail(self) -> str:
        if self.still is not None:
            return f"it would stand still from {self.still:.0f} s"
        return (
            f"it leaves again at {self.errands[1][0]:.0f} s"
            if self.errands[1:]
            else "that lasts to the end"
        )


_State = tuple[float, float, _Levels, int]
"""Time left [s], distance of the robot [m], levels, number of the way in which it works (-1: none)."""


class _Question:
    """One decision: its numbers, and the dynamic program over them.

    A move is the number of a way, or of an errand (counted after the ways), or -1, to wait. Levels are the values of
    the attributes that errands restore; more is better. A solution is for one side: all as expected (0), at its worse
    end (-1) or at its better end (1); but whether an errand arrives is always judged at the worse end.
    """

    def __init__(self, kb: KnowledgeBase, worth: Worth, steps: int) -> None:
        self._kb, self._worth, self._steps, self._left = kb, worth, steps, worth.deadline - kb.now
        self._h = self._left / steps
        self._names = list(
            dict.fromkeys(name for errand in worth.errands for name in errand.restores)
        )
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
        """Return how fast levels change while an action is done; an empty name stands for waiting."""
        slopes: _Slopes = []
        for name, level in zip(self._names, self._levels, strict=True):
            element, span, doing = (
                self._kb.model.attributes[name],
                _SLOPE_S,
                (action,) if action else (),
            )
            now = self._kb.forecast(name, 0.0, doing=doing).value  # the measured level may be old
            level = level if now is None else now
            ahead = self._kb.forecast(name, span, doing=doing)
            while ahead.value in (element.low, element.high) and span > 0.01:  # at a limit it stops
                span /= 2
                ahead = self._kb.forecast(name, span, doing=doing)
            self.unknown = self.unknown or (ahead.reason if ahead.value is None else "")
            ends = [
                ahead.value if end is None else end for end in (ahead.low, ahead.value, ahead.high)
            ]
            slopes.append(tuple([0.0 if end is None else (end - level) / span for end in ends]))
        return slopes

    def _ways_of(self, gain: Gain) -> Iterator[_Way]:
        kb, action, names = self._kb, self._kb.actions[gain.action], self._names
        is_low = any(
            one.attribute in names and one.status is Status.VIOLATED for one in action.constraints
        )
        if not is_low and not kb.is_feasible(gain.action):
            return  # it cannot be foreseen when it is feasible again
        slopes = self._slopes(gain.action)
        for name, rate in _rates(gain):
            constraints = (
                *action.constraints,
                *(kb.configurations[name].constraints if name else ()),
            )
            needed = [
                one for one in constraints if one.attribute in names and one.operator in _LEAST
            ]
            least = [
                max([one.value for one in needed if one.attribute == each], default=-inf)
                for each in names
            ]
            held = [
                [(True,) * 3] * self._steps,
                *(self._holding(one) for one in constraints if one not in needed),
            ]
            rates = [
                [rate * all(mask[side] for mask in now) for now in zip(*held, strict=True)]
                for side in range(3)
            ]
            yield _Way(gain, name, rates, slopes, least)

    def _holding(self, constraint: ConstraintView) -> list[tuple[bool, ...]]:
        """Return in which steps a constraint holds, by side; without a forecast, it stays as it is now."""
        found: list[tuple[bool, ...]] = [(constraint.status is not Status.VIOLATED,) * 3]
        compare = OPERATORS[constraint.operator]
        for step in range(1, self._steps):
            ahead = self._kb.forecast(constraint.attribute, step * self._h)
            if ahead.value is None:
                return found[:1] * self._steps
            ends = [
                ahead.value if end is None else end for end in (ahead.low, ahead.value, ahead.high)
            ]
            ends = ends if constraint.operator in _LEAST else ends[::-1]
            found.append(tuple([compare(end, constraint.value) for end in ends]))
        return found

    def _solved(self, side: int, *, is_late: bool = False) -> _Course:
        """Find the best course; if `is_late`, errands start only when no action can gain anything."""
        self._side, self._is_late = side, is_late
        self._known: dict[_State, tuple[float, int]] = {}
        self._rates = [
            [rate * (1 + side * way.gain.spread) for rate in way.rates[1 + side]]
            for way in self._ways
        ]
        self._top = max(map(max, self._rates))
        self._free = self._without_levels()
        kb, doing = self._kb, -1
        for number, (gain, name, *_) in enumerate(self._ways):
            if kb.actions[gain.action].is_required and (
                not name or kb.configurations[name].is_selected
            ):
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
        """Return gain and best move by step and way before, as if levels always sufficed."""
        free = [[(0.0, -1)] * (len(self._ways) + 1)]
        for step in range(self._steps - 1, -1, -1):
            row, possible = [], [number for number, rates in enumerate(self._rates) if rates[step]]
            for before in (*range(len(self._ways)), -1):
                moves = [
                    (self._worked(before, one, step, self._h) + free[-1][one][0], one)
                    for one in possible
                ]
                row.append(max(moves, default=(free[-1][before][0], -1)))
            free.append(row)
        return free[::-1]

    def _worked(self, before: int, way: int, step: int, time: float) -> float:
        """Return the gain of working in a way for a time [s], less the time to change the configuration."""
        gain, rate = self._ways[way].gain, self._rates[way][step]
        is_switched = before not in (way, -1) and self._ways[before].gain is gain
        return rate * (time - gain.switching_s * is_switched)

    def _freely(self, left: float, before: int) -> tuple[float, int]:
        """Return gain and best move for the time that is left [s], as if levels always sufficed."""
        step = self._step(left)
        (value, move), (later, _) = self._free[step][before], self._free[step + 1][before]
        return later + (value - later) * (left / self._h - (self._steps - step - 1)), move

    def _best(self, state: _State) -> tuple[float, int]:
        """Return the best gain from a state on, and its first move."""
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
        if not self._kept and all(
            self._lasting(levels, way) >= left - _ROUNDING for way in self._ways
        ):
            return self._freely(left, before)
        best, move = -inf, -1
        for number in range(len(self._ways) + len(self._errands)):
            if self._is_late and number >= len(self._ways) and move >= 0:
                break
            after = self._after(state, number)
            if after is not None:
                is_way = number < len(self._ways)
                now = (
                    self._worked(before, number, self._step(left), left - after[0])
                    if is_way
                    else 0.0
                )
                value = now + self._bound(after)
                if value > best + _NOISE and (value := now + self._best(after)[0]) > best + _NOISE:
                    best, move = value, number
        return (best, move) if move >= 0 else (self._best(self._after(state, -1) or state)[0], -1)

    def _after(self, state: _State, move: int) -> _State | None:
        """Return the state after a move; None if the move is not allowed. Waiting always is."""
        left, away, levels, before = state
        time = min(self._h, left)
        if move < 0:
            return round(left - time, 6), away, self._worn(levels, self._idle, time), before
        if move < len(self._ways):
            way = self._ways[move]
            if not self._rates[move][self._step(left)] or self._lasting(levels, way) < 0.999 * time:
                return None
            levels, away = (
                self._worn(levels, way.slopes, time),
                round(max(0.0, away + way.gain.away * time), 3),
            )
            arriving = (
                self._arrives(levels, away, one, self._kept) for one in range(len(self._errands))
            )
            return (
                (round(left - time, 6), away, levels, move)
                if not self._kept or any(arriving)
                else None
            )
        number = move - len(self._ways)
        there, back = self._takes(number, away)
        is_left = self._is_late or self._arrives(levels, away, number, range(len(self._names)))
        if there >= left or not is_left:
            return None
        arrived = zip(
            self._names, self._worn(levels, self._errand_slopes[number], there), strict=True
        )
        restored = tuple(
            [self._errands[number].restores.get(name, level) for name, level in arrived]
        )
        left = round(max(0.0, left - max(there + back, _FINEST_S)), 6)
        return left, away, self._worn(restored, self._errand_slopes[number], back), -1

    def _step(self, left: float) -> int:
        return min(int(self._steps - left / self._h + _ROUNDING), self._steps - 1)

    def _bound(self, state: _State) -> float:
        """Return an upper bound of the gain from a state: levels suffice, run out, or one more errand is done."""
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
        """Return how long the levels suffice for a way [s]; -1 if they do not."""
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
        """Tell whether enough of some levels is left at the end of an errand, at the worse ends of everything."""
        one, slopes = self._errands[errand], self._errand_slopes[errand]
        takes = one.there(away) * (1 + one.spread)
        return all(levels[index] + slopes[index][0] * takes >= self._keep[index] for index in which)

    def decision(self) -> Decision:
        """Return the best decision now, with its expected gain."""
        if not self._ways:
            return Decision(reason="as without looking ahead, since nothing can be gained")
        worst, best, course = self._solved(-1), self._solved(1), self._solved(0)
        numbers, unit = (
            (course.worth, worst.worth, best.worth),
            f" {self._worth.unit}" if self._worth.unit else "",
        )
        expected = f"{course.worth:.3g}{unit} ({worst.worth:.3g} to {best.worth:.3g})"
        if course.first >= len(self._ways):
            late = self._solved(0, is_late=True)
            when = (
                f"leaving at {late.errands[0][0]:.0f} s, when it has to, "
                if late.errands
                else "not leaving "
            )
            action, now = (
                self._errands[course.first - len(self._ways)].action,
                self._worth.deadline - self._left,
            )
            reason = f"{action} now: leaving at {now:.0f} s {course.tail} and gains {expected}; "
            reason += f"{when}{late.tail} and gains {late.worth:.3g}{unit}"
            return Decision(action, None, *numbers, reason, course.errands)
        later = "".join(f"; {errand} at {time:.0f} s" for time, errand in course.errands)
        doing, name, *_ = self._ways[course.first] if course.first >= 0 else (None, "")
        what = " in ".join(filter(None, (doing.action if doing else "waiting", name)))
        reason = f"{what} now: that gains {expected}{later}"
        return Decision(
            doing.action if doing else None, name or None, *numbers, reason, course.errands
        )
