"""Solving beside the updates: a question is answered in a thread of its own, and the answer taken at a set time."""

from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass

from kb.optimum.problem import Problem
from kb.selection import Optimum

__all__ = ["Beside"]

_RESOLUTION = 1e-6
"""Sums of steps of a clock miss a due time by rounding; no clock of ours tells less than this apart [s]."""


@dataclass(frozen=True, slots=True)
class _Question:
    problem: Problem
    due: float
    answer: "Future[Optimum]"

    def is_due(self, now: float) -> bool:
        return now >= self.due - _RESOLUTION


class Beside:
    """Answers one question at a time, each some time after it was asked.

    Args:
        solve: finds the answer; called in the thread.
        delay: how long after it was asked a question is answered [s].
    """

    def __init__(self, solve: Callable[[Problem], Optimum], delay: float) -> None:
        self._solve = solve
        self._delay = delay
        self._thread: ThreadPoolExecutor | None = None
        self._question: _Question | None = None

    def answer(self, problem: Problem, now: float) -> Optimum | None:
        """Return the answer, without waiting; None while there is none yet.

        Args:
            problem: as it is now. If it is another than the last time, that question is dropped.
            now: the present time [s].
        """
        question = self._question
        if question is None or question.problem != problem:
            self.forget()
            self._ask(problem, now)
            return None
        return question.answer.result() if question.is_due(now) and question.answer.done() else None

    def catch_up(self, now: float) -> None:
        """Wait for an answer that is due by now."""
        if self._question is not None and self._question.is_due(now):
            self._question.answer.exception()

    def forget(self) -> None:
        """Drop the question."""
        if self._question is not None:
            self._question.answer.cancel()
            self._question = None

    def _ask(self, problem: Problem, now: float) -> None:
        if self._thread is None:
            self._thread = ThreadPoolExecutor(1, "best configuration")
        self._question = _Question(problem, now + self._delay, self._thread.submit(self._solve, problem))
