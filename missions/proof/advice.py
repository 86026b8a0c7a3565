"""Idioms that mend a tree: each is applied to the tree, so that the mended tree can be tried."""

from collections.abc import Callable, Iterator
from dataclasses import replace

from py_trees.behaviour import Behaviour
from py_trees.composites import Parallel, Selector, Sequence
from py_trees.decorators import Decorator

from kb import KnowledgeBase
from missions.proof.rig import Rig, acting
from missions.proof.setup import Senses, Setup
from rosa_bt import HasStatus, IsActionFeasible, RosaAction, do_until_unfeasible

Mend = Callable[[Behaviour], Behaviour]
"""Changes a node; returns it, or what comes in its place."""


def mends(setup: Setup) -> Iterator[tuple[str, Setup]]:
    """Yield what could be written instead, in words, with the setup of the mended tree."""
    for place, node in enumerate(Rig(setup).nodes):
        for text, mend in _idioms(node):

            def build(
                kb: KnowledgeBase, senses: Senses, place: int = place, mend: Mend = mend
            ) -> Behaviour:
                nodes = [*setup.build(kb, senses).iterate()]
                old = nodes[place]
                parent = old.parent
                new = mend(old)
                new.parent = parent
                if parent is None:
                    return new
                parent.children[parent.children.index(old)] = new
                if isinstance(parent, Decorator):
                    parent.decorated = new
                return nodes[-1]

            yield text, replace(setup, build=build)


def _idioms(node: Behaviour) -> Iterator[tuple[str, Mend]]:
    """Yield the idioms that can be applied to a node."""
    if isinstance(node, RosaAction) and node.even_if_unfeasible:
        yield f"drop even_if_unfeasible=True of {node.name}", _changed(even_if_unfeasible=False)
    if isinstance(node, HasStatus) and node.element.name in node.kb.actions:
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
    def mend(node: Behaviour) -> Behaviour:
        vars(node).update(attributes)
        return node

    return mend


def _ask(node: Behaviour) -> Behaviour:
    assert isinstance(node, HasStatus)
    return IsActionFeasible(node.name, node.kb, node.element.name)


def _do_until_unfeasible(node: Behaviour) -> Behaviour:
    task, other = (acting(child.iterate())[0] for child in node.children)
    task.parent = None
    other.parent = None
    return do_until_unfeasible(task, other, name=node.name)
