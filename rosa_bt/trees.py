"""Running a tree in somebody else's time: the clock of a simulator, a recording or the wall."""

import logging
from collections import deque
from collections.abc import Callable
from concurrent.futures import Future

from py_trees.behaviour import Behaviour
from py_trees.common import Status
from py_trees.composites import Composite
from py_trees.decorators import Decorator
from py_trees.trees import BehaviourTree

from rosa_bt.behaviours import RosaAction
from rosa_bt.endings import halt, halt_orphans
from rosa_bt.exceptions import TreeChangeError
from rosa_bt.guards import Children, Lock, guard, is_trusted, put_back
from rosa_bt.structure import insert, prune, replace

__all__ = ["GuardedTree", "TreeRunner"]

_log = logging.getLogger(__name__)
Handler = Callable[[BehaviourTree], None]


class GuardedTree(BehaviourTree):
    """A py_trees tree that goes on when a behaviour raises, and that nobody changes in the middle of a tick.

    An exception of a behaviour, also of a plain py_trees one, wherever it is raised (`initialise`, `update`,
    `terminate`, `tick`), is that behaviour's FAILURE with the text as feedback; its parent takes it from there. The
    children of a behaviour cannot be changed during a tick: whoever tries fails, and so does the tick, when it is over.

    Args:
        root: the tree.
    """

    def __init__(self, root: Behaviour) -> None:
        super().__init__(root)
        self._lock = Lock()
        self._guarded: dict[Behaviour, Callable[[], None]] = {}
        self._families: dict[Behaviour, Children] = {}
        self._guard()

    def tick(self, pre_tick_handler: Handler | None = None, post_tick_handler: Handler | None = None) -> None:
        """Tick once; handlers and visitors as in py_trees.

        Raises:
            TreeChangeError: a behaviour tried to change the tree; the tick is over, and the tree as it was.
            Exception: of a handler or visitor.
        """
        for handler in [pre_tick_handler, *self.pre_tick_handlers]:
            if handler is not None:
                handler(self)
        self._guard()
        for visitor in self.visitors:
            visitor.initialise()
        self._tick()
        for visitor in self.visitors:
            visitor.finalise()
        for handler in [*self.post_tick_handlers, post_tick_handler]:
            if handler is not None:
                handler(self)
        self.count += 1
        self._tell_refused()

    def release(self) -> None:
        """Take the guards away; the next tick puts them back."""
        for behaviour in list(self._guarded):
            self._let_go(behaviour)

    def _tick(self) -> None:
        passing = [visitor for visitor in self.visitors if not visitor.full]
        full = [visitor for visitor in self.visitors if visitor.full]
        self._lock.is_closed = True
        try:
            for node in self.root.tick():
                for visitor in passing:
                    node.visit(visitor)
            for node in self.root.iterate() if full else ():
                for visitor in full:
                    node.visit(visitor)
        finally:
            self._lock.is_closed = False
            if [parent for parent, children in self._families.items() if put_back(parent, children)]:
                halt_orphans(self.root)

    def _guard(self) -> None:
        """Guard what is new in the tree, and let go of what is not in it any more."""
        guarded, found = self._guarded, 0
        pending = [self.root]
        while pending:
            behaviour = pending.pop()
            found += 1
            children, is_new = behaviour.children, behaviour not in guarded
            if is_new:
                is_free = behaviour is not self.root and is_trusted(behaviour)
                guarded[behaviour] = _do_nothing if is_free else guard(behaviour)
            if is_new or type(children) is not Children:
                behaviour.children = family = Children(children, behaviour, self._lock)
                if isinstance(behaviour, Composite | Decorator):  # those of another kind are its own
                    self._families[behaviour] = family
            if children:
                pending += children
        if found != len(guarded):
            present = set(self.root.iterate())
            for behaviour in [one for one in guarded if one not in present]:
                self._let_go(behaviour)

    def _let_go(self, behaviour: Behaviour) -> None:
        self._guarded.pop(behaviour)()
        self._families.pop(behaviour, None)
        behaviour.children = list(behaviour.children)

    def _tell_refused(self) -> None:
        refused, self._lock.refused = self._lock.refused, []
        if not refused:
            return
        for behaviour in self._guarded:  # what removes a child stops it first, and forgets that it had got to it
            if isinstance(behaviour, Composite) and behaviour.status is Status.RUNNING and behaviour.children:
                behaviour.current_child = behaviour.current_child or behaviour.children[0]
        raise refused[0]


class TreeRunner:
    """Ticks a tree at a fixed period of a clock that is handed in.

    The tree is changed while it runs by asking the runner, at any time and from any thread: `insert`, `replace` and
    `prune` are carried out before the next tick, in the order in which they were asked for. Each returns a future,
    whose exception is the reason why a change was not possible.

    A mission begins when a runner takes its tree over, and ends when the root succeeds or the runner is shut down; what
    interrupted actions saved is forgotten then.

    Args:
        root: the tree.
        clock: gives the time [s].
        period: from one tick to the next [s].

    Attributes:
        tree: the py_trees tree, for visitors and handlers.
        due: when the next tick is due [s].
    """

    def __init__(self, root: Behaviour, *, clock: Callable[[], float], period: float = 0.1) -> None:
        if not period > 0:
            raise ValueError(f"the period of a tree is more than 0 s, not {period!r}")
        self.tree = GuardedTree(root)
        self._clock = clock
        self._period = period
        self._start = clock()
        self._ticks = 0
        self._changes: deque[tuple[Callable[[], None], Future[None]]] = deque()
        self._forget_progress()

    @property
    def due(self) -> float:
        """When the next tick is due [s]."""
        return self._start + self._ticks * self._period

    @property
    def status(self) -> Status:
        """Status of the root after the last tick."""
        return self.tree.root.status

    def update(self) -> bool:
        """Tick once if a tick is due; tell whether it was. Ticks that were missed are not made up for."""
        now = self._clock()
        if now < self.due:
            return False
        self._ticks = int((now - self._start) / self._period + 1e-9) + 1
        self.tick()
        return True

    def tick(self) -> None:
        """Carry out the changes asked for, then tick once.

        Raises:
            TreeChangeError: a behaviour tried to change the tree itself; the tick is over, and the tree goes on.
            Exception: what a handler or visitor raised, or whatever interrupted the tick, after every running behaviour
                was stopped, so that nothing stays open.
        """
        self._change()
        try:
            self.tree.tick()
        except TreeChangeError:
            raise
        except BaseException:
            halt(self.tree.root)
            raise
        if self.status is Status.SUCCESS:
            self._forget_progress()

    def insert(self, child: Behaviour, parent: Behaviour, index: int | None = None) -> Future[None]:
        """Add a subtree to the children of a composite before the next tick.

        Args:
            child: the subtree; it has no parent yet, and is set up if it needs to be.
            parent: the composite.
            index: before which child; None for after the last.
        """
        return self._ask(lambda: insert(self.tree.root, child, parent, index))

    def replace(self, old: Behaviour, new: Behaviour) -> Future[None]:
        """Put a subtree, or another root, in the place of one before the next tick; the old one is stopped."""

        def change() -> None:
            self.tree.root = replace(self.tree.root, old, new)

        return self._ask(change)

    def prune(self, subtree: Behaviour) -> Future[None]:
        """Take a subtree out of the tree before the next tick, and stop it."""
        return self._ask(lambda: prune(self.tree.root, subtree))

    def shutdown(self) -> None:
        """Stop what is running, so that every request is released, and shut the tree down.

        Raises:
            Exception: the first that the `shutdown` of a behaviour raised, when all were shut down.
        """
        for _, answer in self._changes:
            answer.cancel()
        self._changes.clear()
        halt(self.tree.root)
        self._forget_progress()
        self.tree.release()
        errors = []
        for behaviour in list(self.tree.root.iterate()):
            try:
                behaviour.shutdown()
            except Exception as error:  # the others have to be shut down all the same
                errors.append(error)
        if errors:
            raise errors[0]

    def _ask(self, change: Callable[[], None]) -> Future[None]:
        answer: Future[None] = Future()
        self._changes.append((change, answer))
        return answer

    def _change(self) -> None:
        while self._changes:
            change, answer = self._changes.popleft()
            if not answer.set_running_or_notify_cancel():
                continue
            try:
                change()
            except Exception as error:
                _log.warning("the tree was not changed: %s", error)
                answer.set_exception(error)
            else:
                answer.set_result(None)

    def _forget_progress(self) -> None:
        for behaviour in self.tree.root.iterate():
            if isinstance(behaviour, RosaAction):
                behaviour.forget_progress()


def _do_nothing() -> None:
    """Release what was not guarded."""
