"""The domain that a mission's planned task layer works with: from files, or made of what its actions declare."""

from collections.abc import Callable, Mapping
from inspect import signature
from typing import Any

from py_trees.behaviour import Behaviour

from missions.engine.mission import Mission, MissionError
from rosa_pddl import ActionSchema, Declarations, DeclaredProblem, Domain, load_domain

Action = Callable[..., Behaviour]


def by_schema(*actions: Action) -> Mapping[str, Action]:
    """Return actions by the names that their schemas give them, for `Mission(actions=...)`.

    Raises:
        MissionError: one declares no schema, or two declare the same name.
    """
    named: dict[str, Action] = {}
    for action in actions:
        schema: Any = getattr(action, "schema", None)
        name = schema.name if isinstance(schema, ActionSchema) else getattr(action, "__name__", repr(action))
        schema_of(name, action)
        if named.setdefault(name, action) is not action:
            raise MissionError(f"two actions declare the schema {name!r}; give each its own name")
    return named


def schema_of(name: str, action: Action) -> ActionSchema:
    """Return what an action declares.

    Raises:
        MissionError: it declares nothing, or is listed under another name.
    """
    schema: Any = getattr(action, "schema", None)
    title = getattr(action, "__name__", repr(action))
    if not isinstance(schema, ActionSchema):
        advice = f"write schema = ActionSchema({name!r}, ...) in it, or give the mission a domain file"
        raise MissionError(f"the action {title} declares no schema; {advice}")
    if schema.name != name:
        raise MissionError(f"the action {title} is listed as {name!r}, but declares {schema.name!r}")
    return schema


def declarations_of(mission: Mission) -> Declarations | None:
    """Return what the PDDL of a mission is made of; None if it has files, or nothing to plan with.

    Raises:
        MissionError, rosa_pddl.PddlError: an action declares nothing, or what has no meaning.
    """
    if mission.domain is not None or not isinstance(mission.problem, DeclaredProblem):
        return None
    schemas = [schema_of(name, action) for name, action in mission.actions.items()]
    return Declarations(mission.name, schemas, mission.problem)


def mission_domain(mission: Mission) -> Domain:
    """Return the domain and problem of a mission.

    Raises:
        MissionError: it has neither files nor declarations, or only one of two files.
        rosa_pddl.PddlError: they cannot be read.
    """
    declared = declarations_of(mission)
    if declared is not None:
        return declared.load()
    if mission.domain is None or mission.problem is None:
        raise MissionError(f"mission {mission.name} has no PDDL domain and problem; run it with --task bt")
    if isinstance(mission.problem, DeclaredProblem):
        raise MissionError(f"mission {mission.name} has a domain file but a declared problem; give both as files")
    return load_domain(mission.domain, mission.problem)


def check_facts(mission: Mission) -> None:
    """Raise unless the facts of a mission are called as they have to be.

    Raises:
        MissionError: they take something else; the message says what.
    """
    try:
        signature(mission.facts).bind(None, None)
    except TypeError as error:
        needed = f"the facts of mission {mission.name} are called with the knowledge base and the percepts"
        raise MissionError(f"{needed}: {error}; write facts=lambda kb, percepts: {{...}}") from error
