"""Which ROSA actions a behaviour tree or PDDL files use, found without running either."""

from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from typing import Final

from py_trees.behaviour import Behaviour

from kb import KnowledgeBase, Model
from missions.engine.mission import Mission, MissionError, Percepts, built
from missions.engine.registry import load
from missions.engine.task_layer import declarations_of
from rosa_bt import IsActionFeasible, RosaAction
from rosa_bt.idioms import unguarded
from rosa_pddl.domain import ACTION_TYPE
from rosa_pddl.syntax import Node, Source, read_source, section, typed

ACTION_SUFFIX: Final = "_action"


Uses = list[tuple[str, str]]
"""Names of actions, each with the place where it stands; an empty name is one that a tree only gets as it runs."""


class _Tolerant(KnowledgeBase):
    """A knowledge base of which trees may ask for actions that there are not, so that they can be built and judged."""

    def is_feasible(self, action: str) -> bool:
        return True


def tree_builder(reference: str) -> Callable[..., object]:
    """Return what is given as module:callable; MissionError if it cannot be imported or called."""
    found: object = load("tree", reference, {}, "none by name, a tree is given as module:callable")
    if not callable(found):
        raise MissionError(f"{reference!r} is a {type(found).__name__}, not a function that builds a tree")
    return found


def names_in_tree(build: Callable[..., object], model: Model, title: str) -> tuple[Uses, Uses]:
    """Return the actions that the behaviours of a tree are about; and those that go on when they become unfeasible.

    It is built with a knowledge base and percepts, or with as many of these as it needs.
    """
    root = built(title, Behaviour, build, _Tolerant(model), Percepts())  # type: ignore[type-abstract]  # only asked about
    asking = [one for one in root.iterate() if isinstance(one, IsActionFeasible | RosaAction)]
    uses, careless = (
        [(_action(one), f"behaviour {one.name!r} of {title}") for one in some] for some in (asking, unguarded(root))
    )
    return uses, careless


def _action(behaviour: IsActionFeasible | RosaAction) -> str:
    try:
        return behaviour.action
    except Exception:  # py_trees raises several kinds when a port is not connected before the tree runs
        return ""


def names_in_pddl(paths: Iterable[Path]) -> Uses:
    """Return the actions that PDDL files are about: the constants and objects of type action or of a type below it.

    A domain by itself may have none; then each predicate `(NAME_action ?a)` of one action stands for the action NAME.
    """
    sources = [read_source(path) for path in paths]
    parents = {name.lower: of for source in sources for name, of in _declared(source, section(source, ":types"))}
    found = [
        (str(name), _place(source, name))
        for source in sources
        for name, of in _declared(source, section(source, ":constants") + section(source, ":objects"))
        if _is_action(of, parents)
    ]
    return found or [use for source in sources for use in _by_predicate(source, parents)]


def planned_names(mission: Mission) -> Uses:
    """Return the ROSA actions that the planned task layer of a mission is about."""
    declared = declarations_of(mission)
    if declared is not None:
        objects = [name for name, kind in declared.problem.objects.items() if kind == ACTION_TYPE]
        return [(name, f"the schemas of {mission.name}") for name in dict.fromkeys([*declared.rosa_actions, *objects])]
    return names_in_pddl(path for path in (mission.domain, mission.problem) if isinstance(path, Path))


def _by_predicate(source: Source, parents: Mapping[str, str]) -> Iterator[tuple[str, str]]:
    for predicate in section(source, ":predicates"):
        name = predicate.children[0]
        types = [of for _, of in _declared(source, predicate.children[1:])]
        if name.lower.endswith(ACTION_SUFFIX) and len(types) == 1 and _is_action(types[0], parents):
            yield str(name)[: -len(ACTION_SUFFIX)], _place(source, name)


def _declared(source: Source, nodes: Iterable[Node]) -> list[tuple[Node, str]]:
    """Return what a list declares, each with its type in lower case; what has no type is an object."""
    return [(name, "object" if of is None else of.lower) for name, of in typed(source, nodes)]


def _is_action(name: str, parents: Mapping[str, str]) -> bool:
    seen: set[str] = set()
    while name != ACTION_TYPE and name in parents and name not in seen:
        seen.add(name)
        name = parents[name]
    return name == ACTION_TYPE


def _place(source: Source, node: Node) -> str:
    return f"{source.file}:{node.line}:{node.column}"
