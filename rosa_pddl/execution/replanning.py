"""The dialogue with the planner: when it is asked, what it answered, and why there is no plan."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from rosa_pddl.domain import Domain, State, Step
from rosa_pddl.execution.asking import Asking, PlansAhead
from rosa_pddl.execution.course import Course
from rosa_pddl.execution.diagnosis import Diagnosis
from rosa_pddl.execution.goals import Goals
from rosa_pddl.execution.policy import Decision, ReplanningPolicy, wait_s
from rosa_pddl.execution.quest import Quest
from rosa_pddl.planning import Outcome, PlanningResult

__all__ = ["Found", "PlanRecord", "Replanning"]


@dataclass(frozen=True)
class PlanRecord:
    """One planning that happened.

    Args:
        at_s: when it was asked for [s, the executor's clock].
        reason: why, in words.
        outcome: how it ended.
        steps: the plan; empty unless solved.
        engine: the engine that was asked.
        message: what was tried and what to do about it; empty when solved.
    """

    at_s: float
    reason: str
    outcome: Outcome
    steps: tuple[Step, ...]
    engine: str
    message: str = ""


@dataclass(frozen=True)
class _Hopeless:
    """What there is no plan from, and why."""

    state: State
    domain: Domain
    numbers: Mapping[str, float]
    why: str


@dataclass(frozen=True)
class Found:
    """A plan, and why it was asked for.

    Args:
        course: the plan, of which nothing has happened yet.
        decision: why.
    """

    course: Course
    decision: Decision


class Replanning:
    """Asks for plans as a policy allows, and finds out why there is none.

    Args:
        goals: what shall be reached.
        quest: turns goals into problems.
        planner: answers.
        clock: returns the time [s].
        delay_s: an answer is taken this long after the question [s]; None to take it when it is there.
        policy: sets the rate.
    """

    def __init__(
        self,
        goals: Goals,
        quest: Quest,
        planner: PlansAhead,
        clock: Callable[[], float],
        delay_s: float | None,
        policy: ReplanningPolicy,
    ) -> None:
        self._goals, self._quest = goals, quest
        self._clock, self._policy = clock, policy
        self._asking = Asking(planner, clock, delay_s)
        self._last_asked_s: float | None = None
        self._wanted: Decision | None = None
        self._diagnosis: Diagnosis | None = None
        self._asked_in = quest.domain
        self._hopeless: _Hopeless | None = None
        self.records: list[PlanRecord] = []

    @property
    def is_busy(self) -> bool:
        """Whether a plan is wanted or being made."""
        return self._wanted is not None or self._asking.is_under_way

    @property
    def has_answer(self) -> bool:
        """Whether an answer of the planner can be taken."""
        return self._asking.has_answer

    def catch_up(self) -> None:
        """Wait for an answer that is due; see `PlanExecutor.catch_up`."""
        self._asking.catch_up()

    def why_hopeless(self, state: State) -> str | None:
        """Return why there is no plan from a state, if that has been found; None if it has to be asked."""
        hopeless = self._hopeless
        if hopeless is None or (hopeless.state, hopeless.domain) != (state, self._quest.domain):
            return None
        return hopeless.why if self._quest.is_no_easier(hopeless.numbers) else None

    @property
    def had_no_plan(self) -> bool:
        """Whether the last answer was that there is none."""
        return self._hopeless is not None

    def want(self, decision: Decision) -> None:
        """Note that a plan is to be made; what is being planned for something else is given up if it is needed."""
        if self._wanted is not None and self._wanted.is_needed:
            return
        self._wanted = decision
        if decision.is_needed:
            self._asking.give_up()
            self._diagnosis = None

    def goals_changed(self, *, is_needed: bool) -> None:
        """Plan for the goals as they are now, if a plan was being made; what was found hopeless may not be."""
        self._hopeless = None
        if self._asking.is_under_way:
            self._asking.give_up()
            self._diagnosis = None
            self.want(Decision("the goals changed", is_needed))

    def ask_if_allowed(self, state: State) -> str | None:
        """Ask for the plan that is wanted, unless the policy says that it is too soon; return what to tell of it."""
        if self._wanted is None:
            return None
        now_s = self._clock()
        left_s = wait_s(self._policy, now_s, self._last_asked_s)
        if left_s > 0.0:
            return f"planning in {left_s:.2g} s: {self._wanted.reason}"
        decision, self._wanted = self._wanted, None
        self._asked_in = self._quest.domain
        self._asking.ask(self._quest.problem(state, self._goals), state, decision)
        self._last_asked_s, self._hopeless = now_s, None
        return f"planning: {decision.reason}"

    def forget(self) -> None:
        """Give up what is wanted or being planned; what was found hopeless stays so."""
        self._asking.give_up()
        self._wanted = self._diagnosis = None

    def take(self, state: State) -> Found | None:
        """Return a plan if one has just been found.

        Args:
            state: to plan from if there is none.
        """
        answer = self._asking.take()
        if answer is None:
            return None
        question, result = answer
        if question.decision is None:
            assert self._diagnosis is not None
            self._diagnose(self._diagnosis.answered(result), state)
            return None
        decision = question.decision
        result, promised = self._quest.read(result, self._goals)
        outcome, steps, domain = result.outcome, result.steps, self._quest.domain
        is_fresh = state == question.state and domain is self._asked_in
        self.records.append(PlanRecord(question.at_s, decision.reason, outcome, steps, result.engine, result.message))
        if outcome.is_solved:
            course = Course.of(domain, result, promised)
            wrong = course.replay(state).flaw if is_fresh else None
            if wrong is None:
                return Found(course, decision)
            # the same question would get the same answer, again and again
            why = f"no plan: what {result.engine} gave cannot be done event by event: {wrong}"
            self._give_up(state, question.problem.costs, why)
            return None
        if not decision.is_needed:
            return None
        if not is_fresh:
            self.want(Decision("the state changed during planning", is_needed=True))
            return None
        told = result.message or decision.reason
        why = f"no plan: {told}" if str(outcome) in told else f"no plan, {outcome}: {told}"
        costs, is_open = question.problem.costs, not outcome.is_trouble
        diagnosis = Diagnosis(domain, state, self._goals.hard, why, costs, is_open=is_open)
        self._diagnose(diagnosis, state)
        if result.safe_step is None:
            return None
        safe = PlanningResult(Outcome.SOLVED, (result.safe_step,))
        return Found(Course.of(domain, safe, ()), Decision("there is no plan", is_needed=True))

    def _give_up(self, state: State, numbers: Mapping[str, float], why: str) -> None:
        """Note that there is no plan with the numbers that were asked with, which may be others by now."""
        self._hopeless = _Hopeless(state, self._quest.domain, numbers, why)

    def _diagnose(self, diagnosis: Diagnosis, state: State) -> None:
        """Ask on, or conclude that there is no plan; when the state has changed it is better to plan anew."""
        domain = self._quest.domain
        if (state, domain) != (diagnosis.state, diagnosis.domain):
            self.want(Decision("the state changed", is_needed=True))
        elif diagnosis.next_question is not None:
            self._diagnosis = diagnosis
            self._asking.ask(diagnosis.next_question, state, None)
        else:
            self._diagnosis = None
            self._give_up(state, diagnosis.costs, "; ".join(map(str, (diagnosis, *self._quest.doubts))))
