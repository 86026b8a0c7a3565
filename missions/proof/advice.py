"""Idioms that mend a tree: each is applied to the tree, so that the mended tree can be tried."""

from collections.abc import Callable, Iterator
from dataclasses import replace

from py_trees.behaviour import Behaviour
from py_trees.blackboard import Blackboard
from py_trees.composites import Composite, Parallel, Selector, Sequence
from py_trees.decorators import Decorator

from kb import KnowledgeBase
from missions.proof.causes import Senses
from missions.proof.rig import Rig, Setup
from rosa_bt import ForAction, HasStatus, IsActionFeasible, RosaAction, do_until_unfeasible

Mend = Callable[[list[Behaviour]], Behaviour]
"""Changes a tree, given all its nodes, and returns its root."""


def mends(setup: Setup) -> Iterator[tuple[str, Setup]]:
    """Yield what could be written instead, in words, with the setup of the mended tree."""
    rig = Rig(setup)
    idioms = [(text, mend) for place in range(len(rig.nodes)) for text, mend in _idioms(rig, place)]
    for text, mend in idioms:

        def build(kb: KnowledgeBase, senses: Senses, mend: Mend = mend) -> Behaviour:
            Blackboard.storage.clear()
            return mend(list(setup.build(kb, senses).iterate()))

        yield text, replace(setup, build=build)


def _idioms(rig: Rig, place: int) -> Iterator[tuple[str, Mend]]:
    """Yield the idioms that can be applied to a node, by its place in the tree."""
    node = rig.nodes[place]
    if isinstance(node, RosaAction) and node.even_if_unfeasible:
        yield (
            f"drop even_if_unfeasible=True of {node.name}",
            _changed(place, even_if_unfeasible=False),
        )
    if isinstance(node, HasStatus) and node.element.name in rig.kb.actions:
        yield f"write IsActionFeasible for {node.name}", lambda nodes: _asking(nodes, place)
    if isinstance(node, Selector | Parallel) and len(node.children) == 2:
        task, other = (_acting(child) for child in node.children)
        if task is not None and other is not None:
            text = f"write do_until_unfeasible({task.name}, {other.name}) in place of {node.name}"
            yield text, lambda nodes: _doing_until(nodes, place, is_bare=False)
            yield (
                f"{text}, without further guards",
                lambda nodes: _doing_until(nodes, place, is_bare=True),
            )
    if isinstance(node, Selector | Sequence) and node.memory:
        yield f"write memory=False in {node.name}", _changed(place, memory=False)
    if isinstance(node, Selector):
        for first in range(1, len(node.children)):
            text = f"put {node.children[first].name} first in {node.name}"
            yield text, lambda nodes, first=first: _first(nodes, place, first)  # type: ignore[misc]  # a class made for one behaviour
    if isinstance(node, Decorator) and type(node).__module__ == Decorator.__module__:
        yield f"drop {type(node).__name__} {node.name}", lambda nodes: _unwrapped(nodes, place)


def _changed(place: int, **attributes: bool) -> Mend:
    def mend(nodes: list[Behaviour]) -> Behaviour:
        vars(nodes[place]).update(attributes)
        return nodes[-1]

    return mend


def _asking(nodes: list[Behaviour], place: int) -> Behaviour:
    node = nodes[place]
    assert isinstance(node, HasStatus)
    return _put(nodes, node, IsActionFeasible(node.name, node.kb, node.element.name))


def _doing_until(nodes: list[Behaviour], place: int, *, is_bare: bool) -> Behaviour:
    node = nodes[place]
    parts = list(node.children)
    if is_bare:
        parts = [_acting(part) or part for part in parts]
    for part in parts:
        part.parent = None
    return _put(nodes, node, do_until_unfeasible(parts[0], parts[1], name=node.name))


def _first(nodes: list[Behaviour], place: int, first: int) -> Behaviour:
    children = nodes[place].children
    children.insert(0, children.pop(first))
    return nodes[-1]


def _unwrapped(nodes: list[Behaviour], place: int) -> Behaviour:
    node = nodes[place]
    child = node.children[0]
    child.parent = None
    return _put(nodes, node, child)


def _acting(node: Behaviour) -> RosaAction | ForAction | None:
    return next((each for each in node.iterate() if isinstance(each, RosaAction | ForAction)), None)


def _put(nodes: list[Behaviour], old: Behaviour, new: Behaviour) -> Behaviour:
    """Put a node in the place of another and return the root."""
    parent = old.parent
    old.parent = None
    if parent is None:
        return new
    new.parent = parent
    parent.children[parent.children.index(old)] = new
    if isinstance(parent, Decorator):
        parent.decorated = new
    assert isinstance(parent, Composite | Decorator)
    return nodes[-1]
