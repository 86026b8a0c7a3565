"""The joint plan as PDDL: the same question for planners that know nothing of corridors, step by step.

Switching and crossing are actions of their own; both cost what the search counts, in whole thousandths.
"""

import re
from collections.abc import Iterable, Iterator
from typing import Final, NamedTuple

from missions.agv.building import Building
from missions.agv.joint import Place, Task
from missions.agv.modes import Mode
from rosa_pddl.domain import FEASIBLE
from rosa_pddl.generation import ActionSchema, Declarations, DeclaredProblem
from rosa_pddl.planning import Planner, PlanningResult
from rosa_pddl.problem import Problem, initial_state

__all__ = [
    "CROSS",
    "SWITCH",
    "Via",
    "Words",
    "asked_of",
    "declarations_of_task",
    "facts_of",
    "numbers_of",
    "problem_of",
]

SWITCH: Final = ActionSchema(
    "switch",
    parameters=("?now - setup", "?next - mode"),
    start=("(configured ?now)",),
    end_effects=("(not (configured ?now))", "(configured ?next)"),
    duration_s=1,
    cost="(switching ?now ?next)",
)
"""Change from one mode to another, where the robot stands."""

CROSS: Final = ActionSchema(
    "cross",
    parameters=("?a - action", "?w - way", "?from ?to - place", "?m - mode"),
    start=("(at ?from)", "(leads ?w ?from ?to)", "(configured ?m)"),
    over_all=("(crosses ?a ?w)", f"({FEASIBLE} ?a)", "(possible ?w ?m)"),
    end_effects=("(not (at ?from))", "(at ?to)"),
    duration_s=60,
    cost="(crossing ?w ?m)",
    action=None,
)
"""Drive a way in a mode; the ROSA action is that of its corridor."""


class Via(NamedTuple):
    """A corridor as it is driven to one of its ends, all of it or from where the robot is within a corridor."""

    corridor: str
    to: str
    is_whole: bool


class Words:
    """What is called what in PDDL, where no two things of any kind have the same name.

    Args:
        building: the map.
        modes: all that there can be.
        has_inside: whether the robot may be within a corridor.

    Attributes:
        actions: the ROSA action of each corridor.
        places: by name; where the robot is within a corridor, by the empty name.
        modes: by name.
        vias: the ways.
        now: the object for how the robot is configured if that is none of the modes.
    """

    def __init__(self, building: Building, modes: Iterable[Mode], *, has_inside: bool = True) -> None:
        self._taken = {SWITCH.name}
        self.actions = {name: self._distinct(f"cross_{name}") for name in building.corridors}
        self.places = {name: self._distinct(name) for name in building.places}
        self.places |= {"": self._distinct("here")} if has_inside else {}
        self.now = self._distinct("now")
        self.by_mode = {self._distinct(re.sub(r"\W", "_", mode.name.lower())): mode for mode in modes}
        self.modes = {mode.name: word for word, mode in self.by_mode.items()}
        self.vias = {
            Via(one.name, to, is_whole): self._distinct(
                f"{one.name}_{self.places[one.other(to) if is_whole else '']}_{to}"
            )
            for is_whole in ((True, False) if has_inside else (True,))
            for one in building.corridors.values()
            for to in one.ends
        }
        self.by_way = {word: via for via, word in self.vias.items()}
        self.building = building

    @property
    def objects(self) -> dict[str, str]:
        """The type of each."""
        return {
            **dict.fromkeys(self.actions.values(), "action"),
            **dict.fromkeys(self.places.values(), "place"),
            **dict.fromkeys(self.modes.values(), "mode"),
            self.now: "setup",
            **dict.fromkeys(self.vias.values(), "way"),
        }

    @property
    def fixed(self) -> Iterator[str]:
        """What is so for good."""
        for via, way in self.vias.items():
            origin = self.building.corridors[via.corridor].other(via.to) if via.is_whole else ""
            yield f"(leads {way} {self.places[origin]} {self.places[via.to]})"
            yield f"(crosses {self.actions[via.corridor]} {way})"

    def place(self, place: Place) -> str:
        """Return the object for where the robot is."""
        return self.places["" if place.corridor else place.name]

    def mode(self, mode: Mode) -> str:
        """Return the object for how the robot is configured."""
        for word, one in self.by_mode.items():
            if (one.components, one.choice.configurations) == (mode.components, mode.choice.configurations):
                return word
        return self.now

    def _distinct(self, wanted: str) -> str:
        while wanted in self._taken:
            wanted += "_"
        self._taken.add(wanted)
        return wanted


def facts_of(words: Words, task: Task) -> dict[str, bool]:
    """Return everything that may change, and whether it is so: where the robot is, how configured, what is possible."""
    possible = {(way, mode) for way, mode, _ in _crossings(words, task)}
    if not task.start[0].corridor:  # a way that was begun within a corridor goes on as one from its end does
        for via, way in words.vias.items():
            whole = words.vias[via._replace(is_whole=True)]
            possible |= {(way, mode) for mode in words.by_mode if (whole, mode) in possible}
    at, configured = words.place(task.start[0]), words.mode(task.start[1])
    return {
        **{f"(at {place})": place == at for place in words.places.values()},
        **{f"(configured {mode})": mode == configured for mode in (*words.by_mode, words.now)},
        **{
            f"(possible {way} {mode})": (way, mode) in possible
            for way in words.vias.values()
            for mode in words.modes.values()
        },
    }


def numbers_of(words: Words, task: Task) -> dict[str, float]:
    """Return what everything costs that is possible now, in whole thousandths."""
    numbers: dict[str, float] = {f"(crossing {way} {mode})": cost for way, mode, cost in _crossings(words, task)}
    setups = {**words.by_mode, **({words.now: task.start[1]} if words.mode(task.start[1]) == words.now else {})}
    for now, one in setups.items():
        for mode, other in words.by_mode.items():
            numbers[f"(switching {now} {mode})"] = task.switching(one, other)[1]
    return numbers


def problem_of(words: Words, task: Task) -> DeclaredProblem:
    """Return a question as a problem of PDDL."""
    facts = [fact for fact, is_so in facts_of(words, task).items() if is_so]
    goal = (f"(at {words.places[task.goal]})",)
    numbers, types = numbers_of(words, task), {"mode": "setup"}
    return DeclaredProblem(goal, words.objects, (*words.fixed, *facts), numbers, types)


def declarations_of_task(task: Task) -> Declarations:
    """Return a question as PDDL by itself; its limits are left out."""
    modes = {mode.name: mode for place in _places(task) for _, mode, *_ in task.crossings(place)}
    words = Words(task.building, modes.values(), has_inside=bool(task.start[0].corridor))
    problem = problem_of(words, task)
    feasible = [f"({FEASIBLE} {action})" for action in (SWITCH.name, *words.actions.values())]
    stated = DeclaredProblem(problem.goal, problem.objects, (*problem.facts, *feasible), problem.numbers, problem.types)
    return Declarations("joint", [SWITCH, CROSS], stated)


def asked_of(planner: Planner, task: Task) -> PlanningResult:
    """Have a planner answer a question; the cost is in whole thousandths."""
    domain = declarations_of_task(task).load()
    return planner.plan(Problem(domain, initial_state(domain)))


def _crossings(words: Words, task: Task) -> Iterator[tuple[str, str, int]]:
    for place in _places(task):
        for way, mode, _, cost in task.crossings(place):
            via = Via(way.corridor.name, way.to, not place.corridor)
            yield words.vias[via], words.modes[mode.name], cost


def _places(task: Task) -> list[Place]:
    start = task.start[0]
    return [*map(Place, task.building.places), *([start] if start.corridor else [])]
