"""The domain that a mission's planned task layer works with: from files, or made of what its actions declare."""

from collections.abc import Callable, Mapping
from typing import Any

from py_trees.behaviour import Behaviour

from missions.engine.mission import Mission, MissionError, built
from rosa_pddl import ActionSchema, Declarations, DeclaredProblem, Domain, load_domain

Action = Callable[..., Behaviour]


def by_schema(*actions: Action) -> Mapping[str, Action]:
    """Return actions by the names that their schemas give them, for `Mission(actions=...)`.

    Raises:
        MissionError: one declares no schema, or two declare the same name.
    """
    named: dict[str, Action] = {}
    for action in actions:
        name = schema_of(action).name
        if named.setdefault(name, action) is not action:
            raise MissionError(f"two actions declare the schema {name!r}; give each its own name")
    return named


def schema_of(action: Action, name: str | None = None) -> ActionSchema:
    """Return what an action declares; MissionError if that is nothing, or has another name than it is listed under."""
    schema: Any = getattr(action, "schema", None)
    title = getattr(action, "__name__", repr(action))
    if not isinstance(schema, ActionSchema):
        advice = f"write schema = ActionSchema({name or title!r}, ...) in it, or give the mission a domain file"
        raise MissionError(f"the action {title} declares no schema; {advice}")
    if name not in (None, schema.name):
        raise MissionError(f"the action {title} is listed as {name!r}, but declares {schema.name!r}")
    return schema


def declarations_of(mission: Mission) -> Declarations | None:
    """Return what the PDDL of a mission is made of; None if it has files, or nothing to plan with."""
    given, title = mission.problem, f"the problem of mission {mission.name}"
    problem = built(title, DeclaredProblem, given) if callable(given) else given
    if mission.domain is not None or not isinstance(problem, DeclaredProblem):
        return None
    schemas = [schema_of(action, name) for name, action in mission.actions.items()]
    return Declarations(mission.name, schemas, problem)


def mission_domain(mission: Mission) -> Domain:
    """Return the domain and problem of a mission; MissionError if it has none, or only one of two files."""
    declared = declarations_of(mission)
    if declared is not None:
        return declared.load()
    if mission.domain is None or mission.problem is None:
        raise MissionError(f"mission {mission.name} has no PDDL domain and problem; run it with --task bt")
    if isinstance(mission.problem, DeclaredProblem) or callable(mission.problem):
        raise MissionError(f"mission {mission.name} has a domain file but a declared problem; give both as files")
    return load_domain(mission.domain, mission.problem)
