"""A planning that goes on beside the ticks: asked, awaited, given up."""

import logging
from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import dataclass
from typing import Protocol

from rosa_pddl.domain import State
from rosa_pddl.exceptions import PlanningBudgetError
from rosa_pddl.execution.policy import Decision
from rosa_pddl.planning import Outcome, PlanningResult, awaited
from rosa_pddl.problem import Problem

__all__ = ["Asking", "PlansAhead", "Question"]

_LOG = logging.getLogger(__name__)

# Sums of tick lengths miss the due time by rounding; no clock of ours tells less than this apart [s].
_CLOCK_RESOLUTION_S = 1e-6
# A planner keeps its own time limit; this much more is waited before it is given up [s].
_GRACE_S = 2.0


class PlansAhead(Protocol):
    """What the executor needs of a planner."""

    @property
    def timeout_s(self) -> float:
        """After this long the planner gives up by itself [s]."""

    def start(self, problem: Problem) -> "Future[PlanningResult]":
        """Begin to plan, without waiting."""


@dataclass(frozen=True)
class Question:
    """What was asked of the planner.

    Args:
        problem: what is to be planned.
        state: the state that was believed, whatever the problem makes of it.
        decision: why it was asked; None if only to find out why there is no plan.
        at_s: when [s, the executor's clock].
    """

    problem: Problem
    state: State
    decision: Decision | None
    at_s: float


class Asking:
    """At most one question at a time.

    Args:
        planner: answers.
        clock: returns the time [s].
        delay_s: an answer is taken this long after the question, whatever it took [s]; None to take it as soon as it is
            there.
    """

    def __init__(self, planner: PlansAhead, clock: Callable[[], float], delay_s: float | None) -> None:
        self._planner, self._clock, self._delay_s = planner, clock, delay_s
        self._future: Future[PlanningResult] | None = None
        self._question: Question | None = None

    @property
    def is_under_way(self) -> bool:
        """Whether something is being planned."""
        return self._question is not None

    def ask(self, problem: Problem, state: State, decision: Decision | None) -> None:
        """Begin to plan, in place of what was being planned."""
        self.give_up()
        self._question = Question(problem, state, decision, self._clock())
        try:
            self._future = self._planner.start(problem)
        except Exception as error:  # a planner must not stop the tree; what it raises is its answer
            self._future = Future()
            self._future.set_exception(error)

    @property
    def has_answer(self) -> bool:
        """Whether the answer is there and due, or will not come any more."""
        return self._future is not None and self._is_due() and (self._future.done() or self._is_late())

    def take(self) -> tuple[Question, PlanningResult] | None:
        """Return the answer with its question if it is due and there; never waits."""
        if self._question is None or self._future is None or not self.has_answer:
            return None
        answer = self._question, self._answer(self._future)
        self._question = self._future = None
        return answer

    def catch_up(self) -> None:
        """Wait for an answer that is due.

        Raises:
            PlanningBudgetError: it needed more wall-clock time than the planner allows.
        """
        if self._future is None or self._delay_s is None or not self._is_due():
            return
        try:
            awaited(self._future, self._planner.timeout_s + _GRACE_S)
        except PlanningBudgetError:
            raise
        except Exception as error:  # it is told by name when the answer is taken
            _LOG.debug("the planner raised %r", error)

    def give_up(self) -> None:
        """Forget the question."""
        if self._future is not None:
            self._future.cancel()
        self._question = self._future = None

    def _is_due(self) -> bool:
        return self._passed_s() >= (self._delay_s or 0.0) - _CLOCK_RESOLUTION_S

    def _is_late(self) -> bool:
        """Whether a planner is not keeping its own time limit; in lock-step the clock says nothing of that."""
        return self._delay_s is None and self._passed_s() > self._planner.timeout_s + _GRACE_S

    def _passed_s(self) -> float:
        assert self._question is not None
        return self._clock() - self._question.at_s

    def _answer(self, future: "Future[PlanningResult]") -> PlanningResult:
        engine = str(getattr(self._planner, "engine", type(self._planner).__name__))
        if not future.done():
            future.cancel()
            message = f"{engine} gave no answer in {self._passed_s():.3g} s; allow more time or ask for less"
            return PlanningResult(Outcome.OUT_OF_TIME, engine=engine, message=message)
        try:
            return future.result()
        except Exception as error:  # a planner of the user's own may raise anything
            return PlanningResult(Outcome.ENGINE_CRASHED, engine=engine, message=f"{type(error).__name__}: {error}")
