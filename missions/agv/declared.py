"""The joint plan as PDDL: the same question for Fast Downward, which knows no limits, as a second opinion.

Switching and crossing are actions of their own; both cost what the search counts, in whole thousandths.
"""

from missions.agv.joint import Place, Task
from missions.agv.modes import Mode
from rosa_pddl.generation import ActionSchema, Declarations, DeclaredProblem
from rosa_pddl.planning import Planner, PlanningResult
from rosa_pddl.problem import Problem, initial_state

__all__ = ["asked_of", "declarations_of_task"]

_SWITCH = ActionSchema(
    "switch",
    parameters=("?now - mode", "?next - mode"),
    start=("(configured ?now)", "(differ ?now ?next)"),
    end_effects=("(not (configured ?now))", "(configured ?next)"),
    cost="(switching ?now ?next)",
    action=None,
)
_CROSS = ActionSchema(
    "cross",
    parameters=("?w - way", "?from - place", "?to - place", "?m - mode"),
    start=("(at ?from)", "(leads ?w ?from ?to)", "(configured ?m)", "(possible ?w ?m)"),
    end_effects=("(not (at ?from))", "(at ?to)"),
    cost="(crossing ?w ?m)",
    action=None,
)


def declarations_of_task(task: Task) -> Declarations:
    """Return a question as PDDL; its limits are left out."""
    objects: dict[str, str] = {}
    facts = [f"(at {_place(task.start[0])})", "(configured now)"]
    numbers: dict[str, float] = {}
    modes: dict[Mode, str] = {}
    places = [Place(name) for name in task.building.places]
    for place in [*places, *([] if task.start[0] in places else [task.start[0]])]:
        objects[_place(place)] = "place"
        for way in task.ways(place):
            name = f"w_{way.corridor.name}_{_place(place)}_{way.to}"
            objects[name] = "way"
            facts.append(f"(leads {name} {_place(place)} {way.to})")
            for other, mode, _, cost in task.crossings(place):
                if other == way:
                    mode_name = modes.setdefault(mode, f"m{len(modes)}")
                    facts.append(f"(possible {name} {mode_name})")
                    numbers[f"(crossing {name} {mode_name})"] = cost
    objects |= dict.fromkeys([*modes.values(), "now"], "mode")
    for one, now in [(task.start[1], "now"), *modes.items()]:
        for other_mode, following in modes.items():
            if now != following:
                facts.append(f"(differ {now} {following})")
                numbers[f"(switching {now} {following})"] = task.switching(one, other_mode)[1]
    problem = DeclaredProblem((f"(at {task.goal})",), objects, tuple(facts), numbers)
    return Declarations("joint", [_SWITCH, _CROSS], problem)


def asked_of(planner: Planner, task: Task) -> PlanningResult:
    """Have a planner answer a question; the cost is in whole thousandths."""
    domain = declarations_of_task(task).load()
    return planner.plan(Problem(domain, initial_state(domain)))


def _place(place: Place) -> str:
    return f"{place.name}_{place.corridor}" if place.corridor else place.name
