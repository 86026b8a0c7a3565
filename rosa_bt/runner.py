"""Running a tree by a clock that is handed in: that of a simulator, a recording or the wall."""

import logging
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from typing import Any, Literal
from weakref import WeakSet

from py_trees.behaviour import Behaviour
from py_trees.common import Duration, Status
from py_trees.composites import Selector, Sequence
from py_trees.trees import BehaviourTree
from py_trees.visitors import VisitorBase

from kb import KnowledgeBase
from rosa_bt.behaviours import KbBehaviour, RosaAction, halt
from rosa_bt.decorators import Clock, ForAction, follow_clock
from rosa_bt.display import svg_tree
from rosa_bt.exceptions import ClockError, on_error, report
from rosa_bt.requests import (
    FAILURE,
    INVALID,
    SUCCESS,
    advance_halting,
    end_halting,
    forget_progress,
    requests_of,
)

_log = logging.getLogger(__name__)
Handler = Callable[[BehaviourTree], None]


class GuardedTree(BehaviourTree):
    """A tree of py_trees that goes on when a behaviour raises.

    If any behaviour raises, in `initialise`, `update`, `terminate` or `tick`, that behaviour fails,
    with the text of the exception as feedback, and its parent handles the failure. The first
    exception of each behaviour is logged with its traceback; visitors that have a method `error`
    are called with each behaviour that raises, and its exception. A behaviour that is taken out of
    the tree is stopped before the next tick at the latest.

    Args:
        clock: gives the time [s] to the behaviours that count time.
        raises: raise the first exception of a tick, after the tree is stopped.

    Attributes:
        errors: the behaviours that raised since the last tick began, with their exceptions.
    """

    def __init__(self, root: Behaviour, clock: Clock, *, raises: bool = False) -> None:
        super().__init__(root)
        self.errors: list[tuple[Behaviour, Exception]] = []
        self._clock = clock
        self._raises = raises
        self._present: list[Behaviour] = []
        self._bases: dict[KnowledgeBase, None] = {}
        self._setup_arguments: dict[str, Any] | None = None
        on_error(root, self)
        self._take_all()

    @property
    def is_halting(self) -> bool:
        """Whether an interrupted action of the tree's knowledge bases still halts."""
        return any(requests_of(kb).halting for kb in self._bases)

    def setup(
        self,
        timeout: float | Duration = Duration.INFINITE,
        visitor: VisitorBase | None = None,
        **kwargs: Any,  # noqa: ANN401  # as py_trees has it
    ) -> None:
        """Call `setup(**kwargs)` of each behaviour.

        Those that come later are set up before a tick.
        """
        super().setup(timeout, visitor, **kwargs)
        self._setup_arguments = kwargs
        self._present = list(self.root.iterate())

    def tick(
        self, pre_tick_handler: Handler | None = None, post_tick_handler: Handler | None = None
    ) -> None:
        """Tick once, with handlers and visitors as in py_trees, which takes longer."""
        self.errors.clear()
        try:
            for handler in filter(None, [pre_tick_handler, *self.pre_tick_handlers]):
                handler(self)
            self._take_all()
            for visitor in self.visitors:
                visitor.initialise()
            self.advance_halting()
            self._raise_error()
            passing = [visitor for visitor in self.visitors if not visitor.full]
            for node in self.root.tick():
                self._raise_error()
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

    def advance_halting(self) -> None:
        """Call `halting` of the interrupted actions that are not over yet; a tick does it first."""
        for kb in self._bases:
            if requests_of(kb).halting:
                advance_halting(kb)

    def shutdown(self) -> None:
        """Stop what is running and shut down every behaviour; an exception is raised at the end."""
        self.errors.clear()
        self._take_all()
        halt(self.root)
        for kb in self._bases:
            end_halting(kb)
        with ExitStack() as stack:
            stack.callback(self._raise_error)
            for behaviour in reversed(list(self.root.iterate())):
                stack.callback(behaviour.shutdown)

    def note_error(self, behaviour: Behaviour, error: Exception) -> None:
        """Keep the exception of a behaviour, and call the visitors that have a method `error`."""
        self.errors.append((behaviour, error))
        for visitor in self.visitors:
            if hasattr(visitor, "error"):
                visitor.error(behaviour, error)

    def _raise_error(self) -> None:
        if self._raises and self.errors:
            raise self.errors[0][1]

    def _take_all(self) -> None:
        """Take what is new in the tree, and let go of what is no longer in it."""
        nodes = list(self.root.iterate())
        if nodes == self._present:
            return
        before = self._present
        self._present = nodes
        for behaviour in _difference(nodes, before):
            self._take(behaviour)
        for behaviour in _difference(before, nodes):
            halt(behaviour)
        for behaviour in nodes:  # a composite that lost its current child starts again
            if not isinstance(behaviour, Selector | Sequence):
                continue
            if behaviour.current_child not in behaviour.children:
                halt(behaviour)

    def _take(self, behaviour: Behaviour) -> None:
        follow_clock(behaviour, self._clock)
        if isinstance(behaviour, KbBehaviour | ForAction):
            self._bases[behaviour.kb] = None
        if behaviour not in _guarded:
            _guard(behaviour)
        if self._setup_arguments is not None:
            try:
                behaviour.setup(**self._setup_arguments)
            except Exception as error:
                report(behaviour, error, " (in setup)")


def _difference(nodes: list[Behaviour], others: list[Behaviour]) -> list[Behaviour]:
    excluded = set(others)
    return [node for node in nodes if node not in excluded]


class _EndedBadly(Exception):
    """A behaviour raised when it was stopped after SUCCESS or FAILURE.

    Its guard has reported it.
    """


_guarded: WeakSet[Behaviour] = WeakSet()


def _guard(behaviour: Behaviour) -> None:
    """Wrap a behaviour, for good: when it raises, it fails, and its children are stopped.

    If it raises while it is interrupted, the interruption goes on.
    """
    tick = behaviour.tick
    stop = behaviour.stop

    def guarded_tick() -> Iterator[Behaviour]:
        try:
            yield from tick()
        except Exception as error:
            _fail(behaviour, stop, error)
            yield behaviour

    def guarded_stop(new_status: Status = INVALID) -> None:
        try:
            stop(new_status)
        except Exception as error:
            for child in behaviour.children:
                halt(child)
            report(behaviour, error, " (at the end)")
            if new_status is INVALID:
                behaviour.status = INVALID
                return
            behaviour.status = FAILURE
            raise _EndedBadly from error

    vars(behaviour).update(tick=guarded_tick, stop=guarded_stop)
    _guarded.add(behaviour)


def _fail(behaviour: Behaviour, stop: Callable[[Status], None], error: Exception) -> None:
    if not isinstance(error, _EndedBadly):
        report(behaviour, error)
        for child in behaviour.children:
            halt(child)
        try:
            stop(FAILURE)
        except Exception as another:
            first = behaviour.feedback_message
            report(behaviour, another, " (at the end)")
            behaviour.feedback_message = f"{first}; then {behaviour.feedback_message}"
    behaviour.status = FAILURE


def _check_choice(argument: str, value: str, choices: tuple[str, ...]) -> None:
    """Raise a ValueError unless a value is one of the choices."""
    if value not in choices:
        raise ValueError(f"{argument} is {' or '.join(map(repr, choices))}, not {value!r}")


class TreeRunner:
    """Ticks a tree at a fixed period of a clock that is handed in.

    A mission begins when a runner is made for a tree, and ends when the root succeeds or the runner
    is shut down. Both drop the progress that interrupted actions saved, except what a store keeps
    for the next program after a shutdown.

    Args:
        root: of the tree.
        clock: gives the time [s].
        period: time between ticks [s].
        on_error: what happens when a behaviour raises: "fail", the behaviour fails, and its parent
            goes on; or "raise", the tree is stopped, and `tick` raises the exception.
        on_clock_set_back: what happens when the clock shows less than before: "follow", ticks go on
            at once and durations go on; or "refuse", the tree is stopped, and `ClockError` is
            raised.

    Attributes:
        tree: the py_trees tree; add visitors and handlers to it, and change it between ticks, e.g.
            `insert_subtree`.
    """

    def __init__(
        self,
        root: Behaviour,
        *,
        clock: Clock,
        period: float = 0.1,
        on_error: Literal["fail", "raise"] = "fail",
        on_clock_set_back: Literal["follow", "refuse"] = "follow",
    ) -> None:
        if not period > 0:
            raise ValueError(f"the period of a tree is more than 0 s, not {period!r}")
        if not callable(clock):
            raise TypeError(f"clock is a function that returns the time [s], not {clock!r}")
        _check_choice("on_error", on_error, ("fail", "raise"))
        _check_choice("on_clock_set_back", on_clock_set_back, ("follow", "refuse"))
        self._clock = clock
        self._period = period
        self._refuses = on_clock_set_back == "refuse"
        self._start = self._now = clock()
        self._set_back_s = 0.0
        self._ticks = 0
        self._is_stopped = False
        self.tree = GuardedTree(root, self._tree_time, raises=on_error == "raise")
        self._forget_progress(keeps_earlier=True)

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

    @property
    def is_halting(self) -> bool:
        """Whether an interrupted action still halts."""
        return self.tree.is_halting

    def setup(self, **kwargs: Any) -> None:  # noqa: ANN401  # as py_trees has it
        """Call `setup(**kwargs)` of each behaviour, once, before the first tick.

        Behaviours that are inserted later are set up with the same arguments before they are
        ticked.
        """
        self.tree.setup(**kwargs)

    def update(self) -> bool:
        """Tick once if a tick is due; return whether it was. Missed ticks are not made up for."""
        now = self._read_clock()
        if now < self.due:
            return False
        self._ticks = int((now - self._start) / self._period + 1e-9) + 1
        self.tick()
        return True

    def tick(self) -> None:
        """Tick once; an exception of a handler, or an interrupt, first stops the tree."""
        self._read_clock()
        if self._is_stopped:
            self.tree.advance_halting()
            return
        self.tree.tick()
        if self.status is SUCCESS:
            self._forget_progress()

    def stop(self) -> None:
        """Interrupt the tree: ticks only let its actions halt, until `is_halting` is False."""
        self._is_stopped = True
        halt(self.tree.root)

    def shutdown(self) -> None:
        """Stop what is running, release all requests, shut down the tree.

        Raises what that raises.
        """
        try:
            self.tree.shutdown()
        finally:
            self._forget_progress(is_shut_down=True)

    def _tree_time(self) -> float:
        """Return the time of the clock, without the jumps back [s]."""
        return self._clock() + self._set_back_s

    def _read_clock(self) -> float:
        now = self._clock()
        before = self._now
        self._now = now
        if now >= before:
            return now
        told = f"the clock of {self.tree.root.name!r} was set back from {before:g} s to {now:g} s"
        if self._refuses:
            halt(self.tree.root)
            raise ClockError(f"{told}; make a new TreeRunner, or say on_clock_set_back='follow'")
        _log.warning("%s; the tree goes on from there", told)
        self._set_back_s += before - now
        self._start = now
        self._ticks = 0
        return now

    def _forget_progress(self, *, keeps_earlier: bool = False, is_shut_down: bool = False) -> None:
        for action in self.tree.root.iterate():
            if isinstance(action, RosaAction) and not (is_shut_down and action.kb.store):
                forget_progress(action.kb, action.name, keeps_earlier=keeps_earlier)
