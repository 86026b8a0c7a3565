"""Running a tree by a clock that is handed in: that of a simulator, a recording or the wall."""

import logging
from collections.abc import Callable
from typing import Any, Literal

from py_trees.behaviour import Behaviour
from py_trees.common import Status
from py_trees.composites import Selector, Sequence
from py_trees.trees import BehaviourTree

from kb import KnowledgeBase
from rosa_bt.behaviours import KbBehaviour, RosaAction, guard, halt
from rosa_bt.decorators import Clock, ForAction, follow_clock
from rosa_bt.exceptions import ClockError, errors_of, report
from rosa_bt.requests import SUCCESS, advance_halting, end_halting, forget_progress, requests_of

_log = logging.getLogger(__name__)
_ON_ERROR = ("fail", "raise")
_ON_CLOCK_SET_BACK = ("follow", "refuse")
Handler = Callable[[BehaviourTree], None]


class TreeRunner(BehaviourTree):
    """A tree of py_trees that is ticked at a fixed period of a clock that is handed in.

    If any behaviour raises, in whatever method, that behaviour fails, with the text of the
    exception as feedback, and its parent handles the failure. The first exception of each behaviour
    is logged with its traceback.

    A mission begins when a runner is made for a tree, and ends when the root succeeds. Both drop
    the progress that interrupted actions saved.

    Change the tree between ticks as in py_trees, e.g. by `insert_subtree`. What is taken out of it
    is stopped before the next tick at the latest. A sequence or selector that lost its current
    child starts again.

    Args:
        root: of the tree.
        clock: gives the time [s].
        period: time between ticks [s].
        on_error: what happens when a behaviour raises: "fail", the behaviour fails, and its parent
            goes on; or "raise", the tree is stopped, and `tick` raises the exception.
        on_clock_set_back: what happens when the clock shows less than before: "follow", ticks go on
            at once and durations go on, also in the knowledge bases of the tree; or "refuse", the
            tree is stopped for good, and `ClockError` is raised.

    Attributes:
        errors: the behaviours that raised since the last tick began, with their exceptions.
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
        for choice, choices in ((on_error, _ON_ERROR), (on_clock_set_back, _ON_CLOCK_SET_BACK)):
            if choice not in choices:
                raise ValueError(f"{choice!r} is none of {', '.join(choices)}")
        super().__init__(root)
        self.errors = errors_of(root)
        self._clock = clock
        self._period = period
        self._raises = on_error == "raise"
        self._refuses = on_clock_set_back == "refuse"
        self._start = self._now = clock()
        self._set_back_s = 0.0
        self._ticks = 0
        self._is_stopped = False
        self._nodes: list[Behaviour] = []
        self._children: list[list[Behaviour]] | None = None
        self._bases: dict[KnowledgeBase, None] = {}
        self._setup_arguments: dict[str, Any] | None = None
        self._take_all()
        self._forget_progress()

    @property
    def tree(self) -> BehaviourTree:
        """The tree of py_trees, which is the runner itself."""
        return self

    @property
    def due(self) -> float:
        """Time at which the next tick is due [s]."""
        return self._start + self._ticks * self._period

    @property
    def status(self) -> Status:
        """Status of the root after the last tick."""
        return self.root.status

    @property
    def is_halting(self) -> bool:
        """Whether an interrupted action of the tree's knowledge bases still halts."""
        return any(requests_of(kb).halting for kb in self._bases)

    def setup(self, *args: Any, **kwargs: Any) -> None:  # noqa: ANN401  # as py_trees has it
        """Call `setup(**kwargs)` of each behaviour, as py_trees does.

        Behaviours that are inserted later are set up with the same arguments before they are
        ticked.
        """
        self._take_all()
        super().setup(*args, **kwargs)
        self._setup_arguments = {
            name: value for name, value in kwargs.items() if name not in ("timeout", "visitor")
        }

    def update(self) -> bool:
        """Tick once if a tick is due; return whether it was. Missed ticks are not made up for."""
        now = self._read_clock()
        if now < self.due:
            return False
        self._ticks = int((now - self._start) / self._period + 1e-9) + 1
        self.tick()
        return True

    def tick(
        self, pre_tick_handler: Handler | None = None, post_tick_handler: Handler | None = None
    ) -> None:
        """Tick once, with handlers and visitors as in py_trees, which takes longer.

        An exception of a handler, or an interrupt, first stops the tree.
        """
        self._read_clock()
        self.errors.clear()
        if self._is_stopped:
            self._begin_tick()
            return
        try:
            for handler in filter(None, [pre_tick_handler, *self.pre_tick_handlers]):
                handler(self)
            for visitor in self.visitors:
                visitor.initialise()
            self._begin_tick()
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
            halt(self.root)
            for visitor in self.visitors:
                visitor.finalise()
            raise
        self.count += 1
        if self.status is SUCCESS:
            self._forget_progress()

    def stop(self) -> None:
        """Interrupt the tree: ticks only let its actions halt, until `is_halting` is False."""
        self._is_stopped = True
        halt(self.root)

    def shutdown(self) -> None:
        """Stop what is running, release all requests, and shut down every behaviour.

        Raises the first exception of these at the end if the runner raises errors.
        """
        self.errors.clear()
        self._take_all()
        halt(self.root)
        for kb in self._bases:
            end_halting(kb)
        for behaviour in self.root.iterate():
            try:
                behaviour.shutdown()
            except Exception as error:
                report(behaviour, error, " (in shutdown)")
        self._raise_error()

    def _begin_tick(self) -> None:
        """Take what is new in the tree, and call `halting` of the actions that are not over yet."""
        self._take_all()
        for kb in self._bases:
            advance_halting(kb)

    def _raise_error(self) -> None:
        if self._raises and self.errors:
            raise self.errors[0][1]

    def _take_all(self) -> None:
        """Take what is new in the tree, and stop what is no longer in it."""
        if [node.children for node in self._nodes] == self._children:
            return
        nodes = list(self.root.iterate())
        before = set(self._nodes)
        present = set(nodes)
        for behaviour in self._nodes:
            if behaviour not in present:
                halt(behaviour)
        self._nodes = nodes
        self._children = [list(node.children) for node in nodes]
        for behaviour in nodes:
            if behaviour not in before:
                self._take(behaviour)
            if not isinstance(behaviour, Selector | Sequence):
                continue
            if behaviour.current_child not in behaviour.children:
                halt(behaviour)

    def _take(self, behaviour: Behaviour) -> None:
        self._adopt(behaviour)
        if self._setup_arguments is not None:
            try:
                behaviour.setup(**self._setup_arguments)
            except Exception as error:
                report(behaviour, error, " (in setup)")

    def _adopt(self, behaviour: Behaviour) -> None:
        """Let a behaviour follow the clock, and guard it."""
        follow_clock(behaviour, self._tree_time)
        guard(behaviour)
        if isinstance(behaviour, KbBehaviour | ForAction):
            self._bases[behaviour.kb] = None
            if not self._refuses:
                behaviour.kb.on_clock_set_back = "follow"
        if hasattr(behaviour, "adopt"):  # it makes behaviours itself, as a plan executor does
            behaviour.adopt = self._adopt_made

    def _adopt_made(self, behaviour: Behaviour) -> None:
        """Adopt a behaviour that another one has just made, and sets up itself."""
        self._adopt(behaviour)
        self._nodes.append(behaviour)

    def _tree_time(self) -> float:
        """Return the time of the clock, without the jumps back [s]."""
        return self._clock() + self._set_back_s

    def _read_clock(self) -> float:
        now = self._clock()
        before = self._now
        self._now = now
        if now >= before:
            return now
        told = f"the clock of {self.root.name!r} was set back from {before:g} s to {now:g} s"
        if self._refuses:
            self.stop()
            raise ClockError(f"{told}; make a new TreeRunner, or say on_clock_set_back='follow'")
        _log.warning("%s; the tree goes on from there", told)
        self._set_back_s += before - now
        self._start = now
        self._ticks = 0
        return now

    def _forget_progress(self) -> None:
        for action in self.root.iterate():
            if isinstance(action, RosaAction):
                forget_progress(action.kb, action.name)
