"""In which ways the robot can be configured in a situation, and what each takes: read off the knowledge base.

All amounts are whole: milliseconds, millijoules and millionths of a collision, rounded once for each corridor and mode
(by at most half of one). From there on nothing is rounded, so that limits are kept to the unit.
"""

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from itertools import product
from typing import Final, NamedTuple

from kb import Choice, KnowledgeBase, Model, Situation
from kb.elements import Constraint, EstimationKind
from kb.status import OPERATORS
from missions.engine.mission import MissionError

GOALS: Final = {"time": 1e3, "energy": 1e3, "collisions": 1e6}
"""What can be weighed: seconds, joules, and collisions expected; and how many of its amounts each is."""

COLLISION_S: Final = 30.0
"""For how long a collision keeps the robot [s]; as the next three own choice."""
SWITCH_S: Final = 0.5
"""To start or stop a component [s]."""
SET_S: Final = 0.1
"""To give a component another configuration [s]."""
STANDING_W: Final = 10.0
"""What the robot draws while it switches [W]."""


@dataclass(frozen=True, eq=False)
class Mode:
    """One way to be configured; the same one is the same object, for one `Modes`.

    Attributes:
        name: of designs and configurations, such as "amcl_kinect fast"; empty if nothing runs.
        choice: a design for each function and a configuration for each component that has some.
        components: that run.
        speed: that its configurations set [m/s]; None if they set none.
        estimates: what designs, components and configurations are estimated to add to each attribute, summed up;
            less than 0 for what they take away.
    """

    name: str
    choice: Choice = field(repr=False)
    components: frozenset[str] = field(repr=False)
    speed: float | None = field(repr=False)
    estimates: Mapping[str, float] = field(repr=False)

    @property
    def setup(self) -> tuple[object, ...]:
        """What two modes have in common if nothing has to be switched from one to the other."""
        return self.components, self.choice.configurations


class Modes:
    """Asks a knowledge base, by situations, which modes of a function are possible under which conditions.

    Conditions that violate the same constraints of the model allow the same modes, so that one situation serves all.
    What was answered is forgotten, modes included, as soon as a fact or the model has changed.

    Raises:
        UnknownName: no such function.
    """

    BOOKKEEPING = "_revision _constraints _found _made"

    def __init__(self, kb: KnowledgeBase, function: str) -> None:
        self._kb, self._function = kb, kb.functions[function].name
        self._revision = -1
        self._constraints: dict[str, list[Constraint]] = {}
        self._found: dict[tuple[object, ...], tuple[Mode, ...]] = {}
        self._made: dict[tuple[object, ...], Mode] = {}

    @property
    def running(self) -> Mode:
        """How the robot is configured now: the components of the function's designs that are active."""
        kb, model = self._kb, self._kb.model
        parts = {part for one in model.designs.values() if one.function == self._function for part in one.components}
        active = [part for part in model.components if part in parts and kb.components[part].is_active]
        selected = {part: kb.components[part].selected_configuration for part in active}
        return _mode(model, Choice({}, {part: name for part, name in selected.items() if name}), frozenset(active))

    def under(self, conditions: Mapping[str, float]) -> tuple[Mode, ...]:
        """Return the modes that are possible while attributes have these values; none if the function is unfeasible."""
        key = self._key(conditions)
        if key not in self._found:
            self._found[key] = tuple(self._possible(self._kb.situation(conditions)))
        return self._found[key]

    def why_none(self, conditions: Mapping[str, float]) -> str:
        """Say why nothing is possible while attributes have these values."""
        situation = self._kb.situation(conditions)
        return situation.why(situation.functions[self._function])

    def _key(self, conditions: Mapping[str, float]) -> tuple[object, ...]:
        """Return which constraints hold; for one with hysteresis, which depends on more than the value, the value."""
        if self._revision != self._kb.revision:
            self._revision, self._found, self._made, self._constraints = self._kb.revision, {}, {}, {}
            for one in self._kb.model.constraints:
                self._constraints.setdefault(one.attribute, []).append(one)
        return tuple(
            [
                value if one.hysteresis else OPERATORS[one.operator](value, one.value)
                for attribute, value in conditions.items()
                for one in self._constraints.get(attribute, ())
            ]
        )

    def _possible(self, situation: Situation) -> Iterator[Mode]:
        model = self._kb.model
        for design in situation.selectable_designs(self._function):
            parts = model.designs[design].components
            configured = [part for part in parts if situation.components[part].configurations]
            for chosen in product(*(situation.selectable_configurations(part) for part in configured)):
                choice = Choice({self._function: design}, dict(zip(configured, chosen, strict=True)))
                if (design, chosen) not in self._made:
                    self._made[design, chosen] = _mode(model, choice, frozenset(parts))
                yield self._made[design, chosen]


def _mode(model: Model, choice: Choice, components: frozenset[str]) -> Mode:
    designs = [model.designs[one] for one in choice.designs.values()]
    configurations = [model.configurations[one] for one in choice.configurations.values()]
    chosen = {id(one) for one in (*designs, *configurations, *(model.components[one] for one in components))}
    estimates: dict[str, float] = {}
    for one in model.estimations:
        if id(one.causer) in chosen:
            sign = -1.0 if one.kind is EstimationKind.NEGATIVE else 1.0
            estimates[one.attribute] = estimates.get(one.attribute, 0.0) + sign * one.value
    speeds = [one.parameters["speed"] for one in configurations if "speed" in one.parameters]
    speed = next((float(one) for one in speeds if isinstance(one, int | float) and not isinstance(one, bool)), None)
    return Mode(" ".join(one.name for one in (*designs, *configurations)), choice, components, speed, estimates)


class Amounts(NamedTuple):
    """Time [ms], energy [mJ], expected collisions [millionths]."""

    time: int
    energy: int
    collisions: int

    @property
    def in_units(self) -> Mapping[str, float]:
        """By goal: [s], [J], and how many collisions are expected."""
        return {name: amount / GOALS[name] for name, amount in zip(GOALS, self, strict=True)}


def crossing(mode: Mode, length_m: float, passed: float) -> Amounts:
    """Return what it takes to drive a length [m] past obstacles; raises MissionError if the model does not say.

    A collision is a matter of chance; what it costs, it costs as often as it is expected: the robot stands for a while.
    """
    if mode.speed is None or not mode.speed > 0.0:
        given = "sets no speed" if mode.speed is None else f"sets speed to {mode.speed:g}"
        raise MissionError(f"{mode.name or 'a mode'} {given}; give its configurations a speed above 0 [m/s]")
    collisions = passed * _taken(mode, "safety")
    time_s = length_m / mode.speed + collisions * COLLISION_S
    return Amounts(round(time_s * 1e3), round(time_s * _taken(mode, "energy") * 1e3), round(collisions * 1e6))


def switching(before: Mode, after: Mode) -> Amounts:
    """Return what it takes to change from one mode to another: one thing after the other, while the robot stands."""
    had, has = before.choice.configurations, after.choice.configurations
    time_s = SWITCH_S * len(before.components ^ after.components)
    time_s += SET_S * sum(had.get(part) != name for part, name in has.items())
    return Amounts(round(time_s * 1e3), round(time_s * STANDING_W * 1e3), 0)


def weighing(weights: Mapping[str, float]) -> Callable[[Amounts], int]:
    """Return what makes a weighted sum of amounts, in whole thousandths."""
    per_ms, per_mj, per_millionth = (weights.get(one, 0.0) * (1e3 / scale) for one, scale in GOALS.items())
    return lambda takes: round(per_ms * takes.time + per_mj * takes.energy + per_millionth * takes.collisions)


def _taken(mode: Mode, attribute: str) -> float:
    """Return how much a mode is estimated to take from an attribute."""
    adds = mode.estimates.get(attribute, math.nan)
    if not adds <= 0.0:
        said = f"adds {adds:g} to" if attribute in mode.estimates else "takes what from"
        advice = "its designs, components or configurations, of the kind 'negative', 0 if it takes nothing"
        raise MissionError(f"{mode.name} {said} {attribute}? give an estimation from 0 to {advice}")
    return 0.0 - adds
