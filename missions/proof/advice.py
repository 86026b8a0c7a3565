"""Idioms that mend a tree: each is applied to the tree, so that the mended tree can be tried."""

from collections.abc import Callable, Iterator
from dataclasses import replace

from py_trees.behaviour import Behaviour
from py_trees.composites import Parallel, Selector, Sequence
from py_trees.decorators import Decorator

from kb import KnowledgeBase
from missions.proof.causes import Senses
from missions.proof.rig import Rig, acting
from missions.proof.setup import Setup
from rosa_bt import HasStatus, IsActionFeasible, RosaAction, do_until_unfeasible

Mend = Callable[[Behaviour], Behaviour | None]
"""Changes a node; returns what comes in its place, if anything does."""


def mends(setup: Setup) -> Iterator[tuple[str, Setup]]:
    """Yield what could be written instead, in words, with the setup of the mended tree."""
    rig = Rig(setup)
    for place, node in enumerate(rig.nodes):
        for text, mend in _idioms(node, rig.kb):

            def build(
                kb: KnowledgeBase, senses: Senses, place: int = place, mend: Mend = mend
            ) -> Behaviour:
                nodes = [*setup.build(kb, senses).iterate()]
                return _put(nodes, nodes[place], mend(nodes[place]))

            yield text, replace(setup, build=build)


def _idioms(node: Behaviour, kb: KnowledgeBase) -> Iterator[tuple[str, Mend]]:
    """Yield the idioms that can be applied to a node."""
    if isinstance(node, RosaAction) and node.even_if_unfeasible:
        yield f"drop even_if_unfeasible=True of {node.name}", _changed(even_if_unfeasible=False)
    if isinstance(node, HasStatus) and node.element.name in kb.actions:
        yield f"write IsActionFeasible for {node.name}", _ask
    if isinstance(node, Selector | Parallel) and len(node.children) == 2:
        parts = [acting(child.iterate()) for child in node.children]
        if all(parts):
            task, other = (part[0].name for part in parts)
            text = f"write do_until_unfeasible({task}, {other}) in place of {node.name}"
            yield text, _do_until_unfeasible
    if isinstance(node, Selector | Sequence) and node.memory:
        yield f"write memory=False in {node.name}", _changed(memory=False)


def _changed(**attributes: bool) -> Mend:
    return lambda node: vars(node).update(attributes)


def _ask(node: Behaviour) -> Behaviour:
    assert isinstance(node, HasStatus)
    return IsActionFeasible(node.name, node.kb, node.element.name)


def _do_until_unfeasible(node: Behaviour) -> Behaviour:
    parts = [acting(child.iterate())[0] for child in node.children]
    for part in parts:
        part.parent = None
    return do_until_unfeasible(parts[0], parts[1], name=node.name)


def _put(nodes: list[Behaviour], old: Behaviour, new: Behaviour | None) -> Behaviour:
    """Put a node in the place of another, if there is one, and return the root."""
    parent = old.parent
    if new is None:
        return nodes[-1]
    if parent is None:
        return new
    new.parent = parent
    parent.children[parent.children.index(old)] = new
    if isinstance(parent, Decorator):
        parent.decorated = new
    return nodes[-1]
