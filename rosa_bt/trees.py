"""Running a tree by a clock that is handed in: that of a simulator, a recording or the wall."""

from collections.abc import Callable, Iterator
from contextlib import ExitStack
from typing import Final
from weakref import WeakSet

from py_trees.behaviour import Behaviour
from py_trees.behaviours import Failure, Running, Success
from py_trees.common import Status
from py_trees.composites import Selector, Sequence
from py_trees.trees import BehaviourTree

from rosa_bt.behaviours import KbBehaviour, RosaAction, begin_mission, halt
from rosa_bt.composites import ForAction
from rosa_bt.display import svg_tree
from rosa_bt.exceptions import in_words

Handler = Callable[[BehaviourTree], None]

_HARMLESS: Final = frozenset(
    {Failure, Running, Selector, Sequence, Success}
)  # they raise nothing; a subclass may
_CAREFUL: Final = (
    KbBehaviour,
    RosaAction,
    ForAction,
)  # these handle exceptions, unless a subclass overrides that


class GuardedTree(BehaviourTree):
    """A tree of py_trees that goes on when a behaviour raises.

    If any behaviour raises, in `initialise`, `update`, `terminate` or `tick`, that behaviour fails, with the text of
    the exception as feedback, and its parent handles the failure. A behaviour that is taken out of the tree is stopped
    before the next tick at the latest.
    """

    def __init__(self, root: Behaviour) -> None:
        super().__init__(root)
        self._present: dict[Behaviour, None] = {}
        self._guard_all()

    def tick(
        self, pre_tick_handler: Handler | None = None, post_tick_handler: Handler | None = None
    ) -> None:
        """Tick once, with handlers and visitors as in py_trees; if one raises, halt the tree and raise that."""
        try:
            for handler in filter(None, [pre_tick_handler, *self.pre_tick_handlers]):
                handler(self)
            self._guard_all()
            for visitor in self.visitors:
                visitor.initialise()
            passing = [visitor for visitor in self.visitors if not visitor.full]
            for node in self.root.tick():
                for visitor in passing:
                    node.visit(visitor)
            full = [visitor for visitor in self.visitors if visitor.full]
            for node in self.root.iterate() if full else ():
                for visitor in full:
                    node.visit(visitor)
            for visitor in self.visitors:
                visitor.finalise()
            for handler in filter(None, [*self.post_tick_handlers, post_tick_handler]):
                handler(self)
        except BaseException:
            try:
                halt(self.root)
            finally:
                for visitor in self.visitors:
                    getattr(visitor, "interrupt", visitor.finalise)()
            raise
        self.count += 1

    def shutdown(self) -> None:
        """Stop what is running, and shut down every behaviour; an exception is raised after all are shut down."""
        self._guard_all()
        halt(self.root)
        with ExitStack() as stack:
            for behaviour in reversed(list(self.root.iterate())):
                stack.callback(behaviour.shutdown)

    def _guard_all(self) -> None:
        present, found = self._present, 0
        pending = [self.root]
        while pending:
            behaviour = pending.pop()
            found += 1
            if behaviour not in present:
                present[behaviour] = None
                if behaviour not in _guarded and (
                    behaviour is self.root or not _is_trusted(behaviour)
                ):
                    _guard(behaviour)
            pending += behaviour.children
        if found != len(present):
            self._let_go()

    def _let_go(self) -> None:
        """Stop what was taken out of the tree, and composites that lost their current child: they start again."""
        before, self._present = self._present, dict.fromkeys(self.root.iterate())
        for behaviour in [one for one in before if one not in self._present]:
            halt(behaviour)
        for behaviour in self._present:
            if (
                isinstance(behaviour, Selector | Sequence)
                and behaviour.current_child not in behaviour.children
            ):
                halt(behaviour)


def _is_trusted(behaviour: Behaviour) -> bool:
    """Tell whether a behaviour needs no guard; with a guard for each, a tick takes about a third longer."""
    kind = type(behaviour)
    as_ours = any(
        issubclass(kind, one) and (kind.tick, kind.stop) == (one.tick, one.stop) for one in _CAREFUL
    )
    return as_ours or kind in _HARMLESS


class _EndedBadly(Exception):
    """A behaviour raised when it was stopped after SUCCESS or FAILURE; its guard has already handled it."""


_guarded: WeakSet[Behaviour] = WeakSet()


def _guard(behaviour: Behaviour) -> None:
    """Wrap a behaviour, for good: when it raises, it fails, with the text as feedback, and its children are stopped.

    If it raises while it is interrupted, the text is its feedback, and the interruption goes on.
    """
    tick, stop = behaviour.tick, behaviour.stop

    def guarded_tick() -> Iterator[Behaviour]:
        try:
            yield from tick()
        except Exception as error:
            _fail(behaviour, stop, error)
            yield behaviour

    def guarded_stop(new_status: Status = Status.INVALID) -> None:
        try:
            stop(new_status)
        except Exception as error:
            for child in behaviour.children:
                halt(child)
            behaviour.feedback_message = f"{in_words(error)} (at the end)"
            behaviour.status = Status.INVALID if new_status is Status.INVALID else Status.FAILURE
            if new_status is not Status.INVALID:
                raise _EndedBadly from error

    vars(behaviour).update(tick=guarded_tick, stop=guarded_stop)
    _guarded.add(behaviour)


def _fail(behaviour: Behaviour, stop: Callable[[Status], None], error: Exception) -> None:
    if not isinstance(error, _EndedBadly):
        behaviour.feedback_message = in_words(error)
        for child in behaviour.children:
            halt(child)
        try:
            stop(Status.FAILURE)
        except Exception as another:
            behaviour.feedback_message += f"; then {in_words(another)} (at the end)"
    behaviour.status = Status.FAILURE


class TreeRunner:
    """Ticks a tree at a fixed period of a clock that is handed in.

    A mission begins when a runner is made for a tree, and ends when the root succeeds or the runner is shut down. Both
    drop the progress that interrupted actions saved, except what a store keeps for the next program after a shutdown.

    Args:
        root: of the tree.
        clock: gives the time [s].
        period: time between ticks [s].

    Attributes:
        tree: the py_trees tree; add visitors and handlers to it, and change it between ticks, e.g. `insert_subtree`.
    """

    def __init__(self, root: Behaviour, *, clock: Callable[[], float], period: float = 0.1) -> None:
        if not period > 0:
            raise ValueError(f"the period of a tree is more than 0 s, not {period!r}")
        self.tree = GuardedTree(root)
        self._clock = clock
        self._period = period
        self._start = clock()
        self._ticks = 0
        begin_mission(root)
        self._forget_progress(lambda action: not action.is_left)

    def _repr_svg_(self) -> str:
        return svg_tree(self.tree.root)

    @property
    def due(self) -> float:
        """Time at which the next tick is due [s]."""
        return self._start + self._ticks * self._period

    @property
    def status(self) -> Status:
        """Status of the root after the last tick."""
        return self.tree.root.status

    def update(self) -> bool:
        """Tick once if a tick is due; return whether it was. Missed ticks are not made up for."""
        now = self._clock()
        if now < self.due:
            return False
        self._ticks = int((now - self._start) / self._period + 1e-9) + 1
        self.tick()
        return True

    def put_off(self, until: float) -> float:
        """Leave out the ticks that are due before a time [s]; return the time of the last one left out [s]."""
        self._ticks = max(
            self._ticks, int((until - self._start) / self._period) - 1
        )  # the quotient may be rounded up
        while self.due < until - 1e-9:  # the two may be rounded differently
            self._ticks += 1
        return self._start + (self._ticks - 1) * self._period

    def tick(self) -> None:
        """Tick once; an exception of a handler or visitor, or an interrupt, is raised after the tree is stopped."""
        self.tree.tick()
        if self.status is Status.SUCCESS:
            self._forget_progress()

    def shutdown(self) -> None:
        """Stop what is running, which releases all requests, and shut down the tree; raises what behaviours raise."""
        try:
            self.tree.shutdown()
        finally:
            self._forget_progress(lambda action: action.kb.store is None)

    def _forget_progress(self, is_over: Callable[[RosaAction], bool] = lambda action: True) -> None:
        for behaviour in self.tree.root.iterate():
            if isinstance(behaviour, RosaAction) and is_over(behaviour):
                behaviour.forget_progress()
