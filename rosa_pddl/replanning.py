"""When to plan anew, the dialogue with the planner, and why there is no plan."""

import logging
from collections.abc import Callable, Generator, Mapping, Sequence
from concurrent.futures import Future
from dataclasses import dataclass, replace
from html import escape
from math import inf
from typing import Literal, Protocol, TypeAlias

from rosa_pddl.domain import Domain, State, Step
from rosa_pddl.exceptions import PlannerSettingError, PlanningBudgetError
from rosa_pddl.goals import Goals, Relevance, SoftGoals
from rosa_pddl.outcomes import Outcome, PlanningResult
from rosa_pddl.plan_monitor import Clash, PlanExecution, PlanMonitor
from rosa_pddl.planner import CERTIFIED, Planner, awaited
from rosa_pddl.problem import Problem, lock_of
from rosa_pddl.syntax import Goal
from rosa_pddl.validate import missing_at_start

_LOG = logging.getLogger(__name__)

# Sums of tick lengths miss the due time by rounding; no clock of ours tells less than this apart [s].
_CLOCK_RESOLUTION_S = 1e-6
# A planner keeps its own time limit; this much more is waited before it is given up [s].
_GRACE_S = 2.0
# After a first failure this long is waited, after each more in a row twice as long, and never longer than the last [s].
_FIRST_PAUSE_S, _LONGEST_PAUSE_S = 0.2, 60.0

PlanningState = tuple[State, Mapping[str, float]]
"""What is believed: the true atoms, and numbers by their text."""


@dataclass(frozen=True)
class ReplanningPolicy:
    """How eager a plan executor is to plan anew.

    A plan that does not reach the goal any more is always replaced; what a running step needs is always watched, and
    the step stopped at once when it is missing.

    Args:
        eager: whether to look for a better plan whenever the world changed by itself though the current plan still
            works. The better plan replaces the current one if it costs less; of running steps what is left counts.
        at_most_every_s: no planning begins sooner than this after the one before [s].
        while_planning: what becomes of steps that run while a plan is needed: `continue` lets those go on whose own
            conditions hold, and they run on if the new plan starts with them; `hold` stops them all.
        retries: how often in a row a planner in trouble is asked again, and a step that failed may be planned with,
            each time after a pause twice as long. After that a planner in trouble is a failure, and the step is left
            out of plans, until a pause of up to a minute is over.
        side_by_side: whether steps of a plan run at the same time that need and change nothing of one another, and that
            share no component; else one runs after the other, unless a temporal planner says when each starts.
        hysteresis: by what share of its own cost a better plan has to be better, once more with each plan that was
            replaced for being dearer; so it comes to an end however much costs change.

    Raises:
        PlannerSettingError: a setting that makes no sense.
    """

    eager: bool = False
    at_most_every_s: float = 0.2
    while_planning: Literal["continue", "hold"] = "continue"
    retries: int = 3
    hysteresis: float = 0.1
    side_by_side: bool = False

    def __post_init__(self) -> None:
        for name in ("at_most_every_s", "retries", "hysteresis"):
            if not 0.0 <= getattr(self, name) < inf:
                raise PlannerSettingError(f"{name} is {getattr(self, name):g}, expected 0 or more")
        if self.while_planning not in ("continue", "hold"):
            message = f"while_planning is {self.while_planning!r}, expected 'continue' or 'hold'"
            raise PlannerSettingError(message)


@dataclass(frozen=True)
class Decision:
    """That a plan is to be made."""

    BOOKKEEPING = "reason cause"

    reason: str
    is_needed: bool
    cause: int | None = None


def decide(policy: ReplanningPolicy, *, flaw: str | None, goals_changed: bool, news: str | None) -> Decision | None:
    """Decide whether to plan anew while there is a plan; None to go on with it."""
    if flaw is not None:
        return Decision(f"the goals changed: {flaw}" if goals_changed else flaw, is_needed=True)
    if goals_changed:
        return Decision("the goals changed", is_needed=False)
    if policy.eager and news is not None:
        return Decision(f"something better may be possible: {news}", is_needed=False)
    return None


def news_of(expected: PlanningState | None, now: PlanningState, matters: Callable[[str], bool]) -> str | None:
    """Return what changed by itself since it was last looked and matters, in words; None if nothing did."""
    if expected is None or expected == now:
        return None
    (before, known), (state, numbers) = expected, now
    atoms = [atom for atom in sorted(state ^ before) if matters(atom)]
    changed = [atom for atom in atoms if atom in state] + [
        f"(not {atom})" for atom in atoms if atom in before and not atom.startswith("(= ")
    ]
    changed += [f"{text} is {value:g}" for text, value in sorted(numbers.items()) if known.get(text) != value]
    return ", ".join(changed[:3]) + (", ..." if len(changed) > 3 else "") if changed else None


class Setbacks:
    """What has failed, a step or, by None, the planner: how often in a row, and until when it is left alone."""

    BOOKKEEPING = "_failed"

    def __init__(self, clock: Callable[[], float], policy: ReplanningPolicy) -> None:
        self._clock, self._policy = clock, policy
        self._failed: dict[Step | None, tuple[int, float]] = {}

    def add(self, what: Step | None) -> bool:
        """Note that it failed once more; return whether it is given up for a while."""
        count = self._failed.get(what, (0, 0.0))[0] + 1
        # a count beyond the longest pause says nothing more
        pause_s = min(_FIRST_PAUSE_S * 2.0 ** min(count - 1, 30), _LONGEST_PAUSE_S)
        self._failed[what] = count, self._clock() + pause_s
        return count > self._policy.retries

    def forget(self, what: Step | None) -> None:
        self._failed.pop(what, None)

    def clear(self) -> None:
        self._failed.clear()

    def count(self, what: Step | None) -> int:
        return self._failed.get(what, (0, 0.0))[0]

    def wait_s(self, what: Step | None) -> float:
        """Return how long it is still left alone [s]."""
        left_s = self._failed.get(what, (0, -inf))[1] - self._clock()
        return left_s if left_s > _CLOCK_RESOLUTION_S else 0.0

    @property
    def left_out(self) -> tuple[Step, ...]:
        """The steps that no plan may have now."""
        steps = [step for step in self._failed if step is not None]
        return tuple(step for step in steps if self.count(step) > self._policy.retries and self.wait_s(step))

    @property
    def weights(self) -> Mapping[Step, int]:
        """How many times its cost each step counts: as often as it has to be tried, by the rule of succession."""
        out, failed = self.left_out, self._failed.items()
        return {step: 0 if step in out else count + 1 for step, (count, _) in failed if step is not None}


class PlansAhead(Protocol):
    """What the executor needs of a planner."""

    @property
    def timeout_s(self) -> float:
        """After this long the planner gives up by itself [s]."""

    def start(self, problem: Problem) -> "Future[PlanningResult]": ...


@dataclass(frozen=True)
class _Question:
    """What was asked of the planner."""

    problem: Problem
    decision: Decision | None
    at_s: float
    delay_s: float
    future: "Future[PlanningResult]"


class PlannerClient:
    """Asks a planner in the background, at most one question at a time."""

    def __init__(self, planner: PlansAhead, clock: Callable[[], float], delay_s: float | None) -> None:
        if delay_s is not None and not 0.0 <= delay_s < inf:
            raise PlannerSettingError(f"delay_s is {delay_s:g} s, expected 0 or more, or None")
        self._planner, self.clock, self._delay_s = planner, clock, delay_s
        self._question: _Question | None = None
        self.was_answered_at_once = False

    @property
    def is_under_way(self) -> bool:
        return self._question is not None

    def ask(self, problem: Problem, decision: Decision | None) -> None:
        self.give_up()
        at_s = self.clock()
        future: Future[PlanningResult]
        try:
            future = self._planner.start(problem)
            tried = future.result().attempts if future.done() else ()
            is_prepared = CERTIFIED in [attempt.way for attempt in tried]
        except Exception as error:  # a planner must not stop the tree; what it raises is its answer
            future, is_prepared = Future(), False
            future.set_exception(error)
        self._question = _Question(problem, decision, at_s, 0.0 if is_prepared else self._delay_s or 0.0, future)
        self.was_answered_at_once = future.done() and (is_prepared or self._delay_s is None)

    def is_prepared(self, problem: Callable[[], Problem]) -> bool:
        """Whether the planner answers with a plan that was made before, so that no time passes."""
        planner = self._planner
        if not isinstance(planner, Planner) or planner.certificate is None:
            return False
        return planner.prepared(problem()) is not None

    @property
    def has_answer(self) -> bool:
        """Whether the answer is there and due, or will not come any more."""
        question = self._question
        if question is None or not self._is_due(question):
            return False
        # in lock-step the clock does not say whether a planner keeps its own time limit
        is_late = self._delay_s is None and self.clock() - question.at_s > self._planner.timeout_s + _GRACE_S
        return question.future.done() or is_late

    def take(self) -> tuple[_Question, PlanningResult]:
        """Return the answer that there is, with its question."""
        question = self._question
        assert question is not None, "nothing was asked; look at has_answer first"
        result = self._answer(question)
        self.give_up()
        return question, result

    def catch_up(self) -> None:
        """Wait for an answer that is due, as long as the planner allows."""
        if self._question is None or self._delay_s is None or not self._is_due(self._question):
            return
        try:
            awaited(self._question.future, self._planner.timeout_s + _GRACE_S)
        except PlanningBudgetError:
            raise
        except Exception as error:  # it is reported by name when the answer is taken
            _LOG.debug("the planner raised %r", error)

    def give_up(self) -> None:
        if self._question is not None:
            self._question.future.cancel()
        self._question, self.was_answered_at_once = None, False

    def _is_due(self, question: _Question) -> bool:
        return self.clock() - question.at_s >= question.delay_s - _CLOCK_RESOLUTION_S

    def _answer(self, question: _Question) -> PlanningResult:
        engine = str(getattr(self._planner, "engine", type(self._planner).__name__))
        if not question.future.done():
            passed_s = self.clock() - question.at_s
            message = f"{engine} gave no answer in {passed_s:.3g} s; allow more time or ask for less"
            return PlanningResult(Outcome.OUT_OF_TIME, engine=engine, message=message)
        try:
            return question.future.result()
        except Exception as error:  # a planner of the user's own may raise anything
            return PlanningResult(Outcome.ENGINE_CRASHED, engine=engine, message=f"{type(error).__name__}: {error}")


Diagnosis: TypeAlias = Generator[Problem, PlanningResult, list[str]]
"""Yields what to ask a planner next, is sent the answer, and returns sentences in the end."""


def diagnosis(problem: Problem, goals: Sequence[Goal]) -> Diagnosis:
    """Ask on after there was no plan for goals, and return why, as far as the planner knows.

    First each goal alone, if there are several; then all of them, were every action feasible, or nothing limited.
    """
    domain, outcomes = problem.domain, [Outcome.UNSOLVABLE_PROVEN] if len(goals) < 2 else []
    for goal in goals[len(outcomes) :]:
        outcomes.append((yield replace(problem, goals=(goal.expression,))).outcome)
    missed = [goal.text for goal, outcome in zip(goals, outcomes, strict=False) if outcome.is_unsolvable]
    found = [f"out of reach: {', '.join(missed)}"] if missed else []
    if all(outcome.is_solved for outcome in outcomes):
        found.append("each goal can be reached alone, but not all together")
    feasible = {one: domain.feasible_atom(one) for one in domain.rosa_actions if domain.tracks_feasibility}
    if out := {name: atom for name, atom in feasible.items() if atom not in problem.state}:
        outcome = (yield replace(problem, state=problem.state.union(out.values()))).outcome
        if outcome.is_solved:
            found.append(f"unfeasible now: {', '.join(out)}; there would be a plan if they were feasible")
        elif outcome.is_unsolvable:
            found.append("there would be no plan even if every action were feasible")
    others = dict[str, Problem]()
    if limited := ", ".join(domain.limited):
        others[f"the limits of {limited}"] = replace(problem, domain=replace(domain, limits=()))
    if lasting := ", ".join(f"{atom} for {left_s:.3g} s" for atom, left_s in problem.until.items()):
        others[f"what is forecast to hold no longer: {lasting}"] = replace(problem, until={})
    for what, other in others.items():
        if (yield other).outcome.is_solved:
            found.append(f"there would be a plan without {what}")
    return found


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
        cause: number of the event of `kb.log` that led to it, by what it made feasible or unfeasible; None if that was
            not why.
    """

    at_s: float
    reason: str
    outcome: Outcome
    steps: tuple[Step, ...]
    engine: str
    message: str = ""
    cause: int | None = None

    def _repr_html_(self) -> str:
        steps = "".join(f"<li>{escape(str(step))}</li>" for step in self.steps)
        said = f"{self.outcome} by {self.engine}, asked at {self.at_s:g} s: {self.reason} {self.message}"
        return f"<p>{escape(said)}</p><ol>{steps}</ol>"


@dataclass(frozen=True)
class _DeadEnd:
    """What there is no plan from, and why, until it is tried again whatever is so then [s]."""

    domain: Domain
    problem: Problem
    why: str
    until_s: float


class Replanning:
    """Asks for plans as a policy allows, and finds out why there is none."""

    BOOKKEEPING = "records _last_asked_s _soft"

    def __init__(
        self, goals: Goals, monitor: PlanMonitor, client: PlannerClient, policy: ReplanningPolicy, clash: Clash | None
    ) -> None:
        self._goals, self._monitor, self._client, self._policy, self._clash = goals, monitor, client, policy, clash
        self._effects, self._clock = monitor.effects, client.clock
        self.matters = Relevance(monitor.effects.domain, goals).matters
        self._last_asked_s = -inf
        self._soft: SoftGoals | None = None
        self._wanted: Decision | None = None
        self._diagnosis: tuple[Problem, str, Diagnosis] | None = None
        self._asked_in = monitor.effects.domain
        self._dead_end: _DeadEnd | None = None
        self._was_stale = False
        self.setbacks, self._in_vain = Setbacks(client.clock, policy), Setbacks(client.clock, policy)
        self.records: list[PlanRecord] = []

    def wait_no_more(self) -> None:
        """Forget when it was asked last, and what has failed."""
        self._last_asked_s = -inf
        self.setbacks.clear()
        self._in_vain.clear()

    @property
    def is_busy(self) -> bool:
        return self._wanted is not None or self._client.is_under_way

    def why_no_plan(self, state: State) -> str | None:
        """Return why there is no plan from a state, if that has been found; None if it has to be asked."""
        dead_end = self._dead_end
        if dead_end is None or dead_end.domain is not self._effects.domain or self._clock() >= dead_end.until_s:
            return None
        is_known = self._is_same(dead_end.problem.state, state) and self._monitor.is_no_easier(dead_end.problem)
        return dead_end.why if is_known else None

    @property
    def had_no_plan(self) -> bool:
        return self._dead_end is not None

    def want(self, decision: Decision) -> None:
        """Note that a plan is to be made; what is being planned for something else is given up if it is needed.

        A planner in trouble is left alone for longer and longer with what is not needed.
        """
        is_kept = self._wanted is not None and self._wanted.is_needed
        if is_kept or (not decision.is_needed and self._in_vain.wait_s(None)):
            return
        self._wanted = decision
        if decision.is_needed:
            self._client.give_up()
            self._diagnosis = None

    def goals_changed(self, *, is_needed: bool) -> None:
        """Plan for the goals as they are now, if a plan was being made; there may be one now."""
        self._dead_end = None
        if self._client.is_under_way:
            self._client.give_up()
            self._diagnosis = None
            self.want(Decision("the goals changed", is_needed))

    def ask_if_allowed(self, state: State, shares: Mapping[Step, float]) -> str | None:
        """Ask for the plan that is wanted, given what shares are left of running steps, or say why it is too soon."""
        if self._wanted is None:
            return None
        now_s = self._clock()
        left_s = max(self._last_asked_s + self._policy.at_most_every_s - now_s, self.setbacks.wait_s(None))
        if left_s > 0.0 and not self._client.is_prepared(lambda: self._problem(state, shares)):
            return f"planning in {left_s:.2g} s: {self._wanted.reason}"
        decision, self._wanted = self._wanted, None
        self._asked_in = self._effects.domain
        self._client.ask(self._problem(state, shares), decision)
        self._last_asked_s, self._dead_end = now_s, None
        return f"planning: {decision.reason}"

    def _problem(self, state: State, shares: Mapping[Step, float]) -> Problem:
        """Return what to ask the planner; soft goals are planned for in a domain of their own."""
        soft, until = self._softened(), self._monitor.until()
        domain, wanted = (soft.domain, [soft.goal]) if soft else (self._effects.domain, [])
        goals = (*(goal.expression for goal in self._goals.hard), *wanted)
        numbers, weights = self._monitor.belief.numbers, self.setbacks.weights
        return Problem(domain, state, goals, numbers, weights, until, shares if until else {})

    def _softened(self) -> SoftGoals | None:
        domain, goals = made_of = self._effects.domain, self._goals.soft
        if goals and (self._soft is None or self._soft.made_of != made_of):
            with lock_of(domain):
                self._soft = SoftGoals(domain, goals)
        return self._soft if goals else None

    def forget(self) -> None:
        """Give up what is wanted or being planned; that there is none stays known."""
        self._client.give_up()
        self._wanted = self._diagnosis = None

    def take(self, state: State) -> tuple[PlanExecution, Decision] | None:
        """Take the answer; return the plan, or what to do while there is none, and why it was asked for."""
        question, result = self._client.take()
        if question.decision is None:
            self._diagnose(result, state)
            return None
        decision = question.decision
        soft, promised = self._softened(), self._goals.hard
        if soft is not None:
            result, reached = soft.kept(result)
            promised += reached
        outcome, domain = result.outcome, self._effects.domain
        is_fresh = domain is self._asked_in and self._is_same(state, question.problem.state)
        record = (question.at_s, decision.reason, outcome, result.steps, result.engine, result.message, decision.cause)
        self.records.append(PlanRecord(*record))
        if not outcome.is_passing:
            self.setbacks.forget(None)
            self._in_vain.forget(None)
        elif not decision.is_needed:
            self._in_vain.add(None)
        if outcome.is_solved:
            plan = PlanExecution.of(domain, result, promised, self._clash)
            wrong = plan.prediction(domain, state).flaw if is_fresh else None
            if wrong is None:
                return plan, decision
            # the same question would get the same answer, again and again
            why = f"no plan: what {result.engine} gave cannot be done event by event: {wrong}"
            self._give_up(state, question.problem, why)
            return None
        return self._without_plan(question, result, state, is_fresh=is_fresh) if decision.is_needed else None

    def _without_plan(
        self, question: _Question, result: PlanningResult, state: State, *, is_fresh: bool
    ) -> tuple[PlanExecution, Decision] | None:
        """Ask on, or again, if that is of use, and return the safe step if there is one that can start."""
        outcome, domain, reason = result.outcome, self._effects.domain, getattr(question.decision, "reason", "")
        why = f"no plan: {result.message or reason}"
        why = why if str(outcome) in why else f"no plan, {outcome}: {result.message or reason}"
        was_stale, self._was_stale = self._was_stale, not is_fresh
        if outcome.is_passing:  # it says nothing of whether there is a plan
            count, is_over = self.setbacks.count(None) + 1, self.setbacks.add(None)
            left_s = self.setbacks.wait_s(None)
            if is_over:
                why = f"{why}; tried {count} times, again in {left_s:.3g} s at the earliest"
                self._give_up(state, question.problem, why, self._clock() + left_s)
            else:
                self.want(Decision(f"{outcome} after {reason}: retry {count} of {self._policy.retries}", True))
        elif not is_fresh:
            self.want(Decision("the state changed during planning", is_needed=True))
        elif outcome.is_trouble:
            self._conclude(state, question.problem, [why])
        else:
            goals = tuple(goal.expression for goal in self._goals.hard)
            asked = question.problem
            unsolved = Problem(domain, state, goals, asked.costs, until=asked.until, shares=asked.shares)
            self._diagnosis = unsolved, why, diagnosis(unsolved, self._goals.hard)
            self._diagnose(None, state)
        safe = result.safe_step
        # what keeps changing must not keep from what is safe
        is_due = (is_fresh or was_stale or outcome.is_passing) and safe not in self.setbacks.left_out
        if safe is None or not is_due or missing_at_start(domain, safe, state) is not None:
            return None
        plan = PlanExecution.of(domain, PlanningResult(Outcome.SOLVED, (safe,)), ())
        return plan, Decision("there is no plan", is_needed=True)

    def _is_same(self, one: State, other: State) -> bool:
        """Whether two states differ in nothing that a plan or a goal may depend on."""
        return not any(map(self.matters, one ^ other))

    def _give_up(self, state: State, problem: Problem, why: str, until_s: float = inf) -> None:
        """Note that there is no plan with the numbers and forecasts that were asked with, which may be others by now.

        Steps that are left out for having failed are tried again when their time has come.
        """
        out = self.setbacks.left_out
        for step in out:
            left_s = self.setbacks.wait_s(step)
            why += f"; {step} has failed {self.setbacks.count(step)} times and is left out for {left_s:.3g} s"
            until_s = min(until_s, self._clock() + left_s)
        self._dead_end = _DeadEnd(self._effects.domain, replace(problem, state=state), why, until_s)

    def _diagnose(self, answer: PlanningResult | None, state: State) -> None:
        """Ask on, or conclude that there is no plan; when the state has changed it is better to plan anew."""
        assert self._diagnosis is not None
        problem, why, asking = self._diagnosis
        if problem.domain is not self._effects.domain or not self._is_same(problem.state, state):
            self._diagnosis = None
            self.want(Decision("the state changed", is_needed=True))
            return
        try:
            # nothing but None may be sent to what has not begun
            self._client.ask(next(asking) if answer is None else asking.send(answer), None)
        except StopIteration as concluded:
            self._diagnosis = None
            self._conclude(state, problem, [why, *concluded.value])

    def _conclude(self, state: State, problem: Problem, why: Sequence[str]) -> None:
        self._give_up(state, problem, "; ".join(map(str, (*why, *self._effects.unmet))))
