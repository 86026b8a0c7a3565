"""Changing a tree between ticks: children inserted, replaced and taken away, and what was running stopped."""

from py_trees.behaviour import Behaviour
from py_trees.composites import Composite, Parallel
from py_trees.decorators import Decorator

from rosa_bt.endings import halt
from rosa_bt.exceptions import TreeChangeError

__all__ = ["insert", "prune", "replace"]


def insert(root: Behaviour, child: Behaviour, parent: Behaviour, index: int | None = None) -> None:
    """Add a subtree to the children of a composite.

    Args:
        root: of the tree.
        child: the subtree; it has no parent yet.
        parent: the composite.
        index: before which child; None for after the last.

    Raises:
        TreeChangeError: it cannot be added there; says why.
    """
    _check_member(root, parent)
    _check_new(root, child)
    if not isinstance(parent, Composite) or _is_fixed(parent):
        raise TreeChangeError(f"{_named(parent)} takes no more children; insert below a Sequence, Selector or Parallel")
    count = len(parent.children)
    if index is not None and not 0 <= index <= count:
        raise TreeChangeError(
            f"{_named(parent)} has {count} children; a child is inserted at 0 to {count}, not {index}"
        )
    parent.insert_child(child, count if index is None else index)


def prune(root: Behaviour, subtree: Behaviour) -> None:
    """Take a subtree out of a tree, and stop it.

    Where it was the child that its parent had got to, the parent goes on with the next one; without a next one it
    begins anew.

    Raises:
        TreeChangeError: it cannot be taken away; says why.
    """
    _check_member(root, subtree)
    parent = subtree.parent
    if parent is None:
        raise TreeChangeError(f"{_named(subtree)} is the root; shut the tree down instead")
    if not isinstance(parent, Composite) or _is_fixed(parent):
        raise TreeChangeError(f"{_named(parent)} cannot be without {_named(subtree)}; replace it instead")
    halt(subtree)
    was_current = parent.current_child is subtree
    index = parent.remove_child(subtree)
    if not was_current or isinstance(parent, Parallel):
        return
    if index < len(parent.children):
        parent.current_child = parent.children[index]
    else:
        halt(parent)


def replace(root: Behaviour, old: Behaviour, new: Behaviour) -> Behaviour:
    """Put a subtree in the place of another one, which is stopped.

    Returns:
        The root of the tree: the new subtree if the old one was the root.

    Raises:
        TreeChangeError: it cannot be put there; says why.
    """
    _check_member(root, old)
    _check_new(root, new)
    parent = old.parent
    halt(old)
    if parent is None:
        return new
    if isinstance(parent, Composite):
        was_current = parent.current_child is old
        parent.replace_child(old, new)
        if was_current:
            parent.current_child = new
    elif isinstance(parent, Decorator):
        parent.children[0] = parent.decorated = new
        old.parent, new.parent = None, parent
    else:
        raise TreeChangeError(f"{_named(parent)} is neither a composite nor a decorator; its children are its own")
    return root


def _check_member(root: Behaviour, behaviour: Behaviour) -> None:
    place: Behaviour | None = behaviour
    while place is not None and place is not root:
        place = place.parent
    if place is None:
        near = sorted({one.name for one in root.iterate()})[:8]
        raise TreeChangeError(f"{_named(behaviour)} is not in the tree of {root.name!r}, which has {', '.join(near)}")


def _check_new(root: Behaviour, behaviour: Behaviour) -> None:
    if not isinstance(behaviour, Behaviour):
        raise TreeChangeError(f"a subtree is a py_trees behaviour, not {behaviour!r}")
    if behaviour.parent is not None or behaviour is root:
        raise TreeChangeError(f"{_named(behaviour)} is part of a tree already; a behaviour has one place")


def _is_fixed(parent: Behaviour) -> bool:
    return bool(getattr(parent, "has_fixed_children", False))


def _named(behaviour: Behaviour) -> str:
    return f"{type(behaviour).__name__} {behaviour.name!r}"
