"""Decides when to replan, exchanges requests and answers with the planner, and explains why there is no plan."""

import logging
from collections.abc import Callable, Generator, Mapping, Sequence
from concurrent.futures import Future
from dataclasses import dataclass, replace
from html import escape
from math import inf
from typing import Literal, Protocol, TypeAlias

from rosa_pddl.domain import Domain, Outcome, PlanningResult, State, Step
from rosa_pddl.exceptions import PlannerSettingError, PlanningBudgetError
from rosa_pddl.goals import Goals, Relevance, SoftGoals
from rosa_pddl.plan_monitor import Clash, PlanExecution, PlanMonitor
from rosa_pddl.planner import CERTIFIED, Planner, awaited
from rosa_pddl.problem import Problem, lock_of
from rosa_pddl.syntax import Goal
from rosa_pddl.validate import missing_at_start

_LOG = logging.getLogger(__name__)

# Sums of tick lengths may miss the due time by a rounding error; shorter times count as none [s].
_CLOCK_RESOLUTION_S = 1e-6
# Time beyond the planner's own time limit to wait for its answer, before it is given up [s].
_GRACE_S = 2.0
# The pause after a first failure, which doubles with each further failure in a row, and the longest pause [s].
_FIRST_PAUSE_S, _LONGEST_PAUSE_S = 0.2, 60.0

MEMORY = 10_000
"""How many plannings are remembered, unless another number is asked for; older ones are forgotten."""

PlanningState = tuple[State, Mapping[str, float]]
"""The believed state: the true atoms, and numbers by their text."""


@dataclass(frozen=True)
class ReplanningPolicy:
    """When a plan executor replans, and what it does meanwhile.

    A plan that no longer reaches the goals is always replaced. The conditions of running steps are always watched, and
    a step is stopped as soon as one of its conditions does not hold.

    Args:
        eager: whether to look for a better plan when the world changes by itself, although the current plan still
            works. A cheaper plan replaces the current one; of running steps, only the share that is left costs.
        at_most_every_s: shortest time between the starts of two plannings [s].
        while_planning: what happens to running steps while a new plan is needed: `continue` lets steps go on whose own
            conditions hold, and keeps them if the new plan starts with them; `hold` stops all steps.
        retries: how often in a row a planner in trouble is asked again, and a failed step is planned again; the pause
            doubles each time. After that, planning fails, or plans leave out the step, until a pause of up to a minute
            is over.
        side_by_side: whether steps of a plan may run at the same time if neither changes what the other needs or
            changes, and they share no component; else only a temporal planner lets steps overlap.
        hysteresis: by which share of its own cost a new plan must be cheaper to replace a working one; this share grows
            by the same amount with each such replacement, so that replacing ends even if costs keep changing.

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
    """The decision to replan: why, whether a plan is needed, and the number of the event that caused it."""

    BOOKKEEPING = "reason cause"

    reason: str
    is_needed: bool
    cause: int | None = None


def decide(
    policy: ReplanningPolicy, *, flaw: str | None, goals_changed: bool, news: str | None
) -> Decision | None:
    """Decide whether to replan while there is a plan; None to keep it."""
    if flaw is not None:
        return Decision(f"the goals changed: {flaw}" if goals_changed else flaw, is_needed=True)
    if goals_changed:
        return Decision("the goals changed", is_needed=False)
    if policy.eager and news is not None:
        return Decision(f"something better may be possible: {news}", is_needed=False)
    return None


def news_of(
    expected: PlanningState | None, now: PlanningState, matters: Callable[[str], bool]
) -> str | None:
    """Return in words the relevant changes that no step made since the last tick; None if there are none."""
    if expected is None or expected == now:
        return None
    (before, known), (state, numbers) = expected, now
    atoms = [atom for atom in sorted(state ^ before) if matters(atom)]
    changed = [atom for atom in atoms if atom in state] + [
        f"(not {atom})" for atom in atoms if atom in before and not atom.startswith("(= ")
    ]
    changed += [
        f"{text} is {value:g}"
        for text, value in sorted(numbers.items())
        if known.get(text) != value
    ]
    return ", ".join(changed[:3]) + (", ..." if len(changed) > 3 else "") if changed else None


class Setbacks:
    """Counts failures in a row of each step, and of the planner (key None), with the time when its pause ends."""

    BOOKKEEPING = "_failed"

    def __init__(self, clock: Callable[[], float], policy: ReplanningPolicy) -> None:
        self._clock, self._policy = clock, policy
        self._failed: dict[Step | None, tuple[int, float]] = {}

    def add(self, what: Step | None) -> bool:
        """Count one more failure and begin a pause; return whether all retries are used up."""
        count = self._failed.get(what, (0, 0.0))[0] + 1
        # larger exponents would only overflow
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
        """Return how much of its pause is left [s]."""
        left_s = self._failed.get(what, (0, -inf))[1] - self._clock()
        return left_s if left_s > _CLOCK_RESOLUTION_S else 0.0

    @property
    def left_out(self) -> tuple[Step, ...]:
        """The steps that plans must not contain now."""
        steps = [step for step in self._failed if step is not None]
        return tuple(
            step for step in steps if self.count(step) > self._policy.retries and self.wait_s(step)
        )

    @property
    def weights(self) -> Mapping[Step, int]:
        """The factor on each step's cost: the expected number of tries, by the rule of succession; 0 leaves it out."""
        out, failed = self.left_out, self._failed.items()
        return {
            step: 0 if step in out else count + 1 for step, (count, _) in failed if step is not None
        }


class PlansAhead(Protocol):
    """What the executor needs from a planner."""

    @property
    def timeout_s(self) -> float:
        """The planner's own time limit for an answer [s]."""

    def start(self, problem: Problem) -> "Future[PlanningResult]": ...


@dataclass(frozen=True)
class _Question:
    """A request to the planner."""

    problem: Problem
    decision: Decision | None
    at_s: float
    delay_s: float
    future: "Future[PlanningResult]"


class PlannerClient:
    """Sends requests to a planner in the background, at most one at a time."""

    def __init__(
        self, planner: PlansAhead, clock: Callable[[], float], delay_s: float | None
    ) -> None:
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
        except Exception as error:  # a planner must not stop the tree; its error is its answer
            future, is_prepared = Future(), False
            future.set_exception(error)
        self._question = _Question(
            problem, decision, at_s, 0.0 if is_prepared else self._delay_s or 0.0, future
        )
        self.was_answered_at_once = future.done() and (is_prepared or self._delay_s is None)

    def is_prepared(self, problem: Callable[[], Problem]) -> bool:
        """Whether the planner would answer at once with a plan of its certificate."""
        planner = self._planner
        if not isinstance(planner, Planner) or planner.certificate is None:
            return False
        return planner.prepared(problem()) is not None

    @property
    def has_answer(self) -> bool:
        """Whether the answer is there and due, or is so late that it is given up."""
        question = self._question
        if question is None or not self._is_due(question):
            return False
        # with a delay, simulated time does not tell whether the planner keeps its time limit
        is_late = (
            self._delay_s is None
            and self.clock() - question.at_s > self._planner.timeout_s + _GRACE_S
        )
        return question.future.done() or is_late

    def take(self) -> tuple[_Question, PlanningResult]:
        """Return the request and its answer."""
        question = self._question
        assert question is not None, "nothing was asked; look at has_answer first"
        result = self._answer(question)
        self.give_up()
        return question, result

    def catch_up(self) -> None:
        """Wait for an answer that is due, at most for the planner's time limit and a little more."""
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
            message = (
                f"{engine} gave no answer in {passed_s:.3g} s; allow more time or ask for less"
            )
            return PlanningResult(Outcome.OUT_OF_TIME, engine=engine, message=message)
        try:
            return question.future.result()
        except Exception as error:  # a planner of the user's own may raise anything
            return PlanningResult(
                Outcome.ENGINE_CRASHED, engine=engine, message=f"{type(error).__name__}: {error}"
            )


Diagnosis: TypeAlias = Generator[Problem, PlanningResult, list[str]]
"""Yields the next problem for the planner, receives its result, and finally returns reasons in sentences."""


def diagnosis(problem: Problem, goals: Sequence[Goal]) -> Diagnosis:
    """Ask more problems after there was no plan, to return why, as far as the planner can tell.

    It asks for each goal alone; then for all goals with every action feasible, without limits, and without forecasts.
    """
    domain, outcomes = problem.domain, [Outcome.UNSOLVABLE_PROVEN] if len(goals) < 2 else []
    for goal in goals[len(outcomes) :]:
        outcomes.append((yield replace(problem, goals=(goal.expression,))).outcome)
    missed = [
        goal.text for goal, outcome in zip(goals, outcomes, strict=False) if outcome.is_unsolvable
    ]
    found = [f"out of reach: {', '.join(missed)}"] if missed else []
    if all(outcome.is_solved for outcome in outcomes):
        found.append("each goal can be reached alone, but not all together")
    if out := {atom: one for atom, one in domain.feasibility.items() if atom not in problem.state}:
        outcome = (yield replace(problem, state=problem.state.union(out))).outcome
        if outcome.is_solved:
            found.append(
                f"unfeasible now: {', '.join(out.values())}; there would be a plan if they were feasible"
            )
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
    """The record of one planning.

    Args:
        at_s: when the plan was requested [s, the executor's clock].
        reason: why it was requested, in words.
        outcome: how it ended.
        steps: the plan; empty unless solved.
        engine: the engine that was asked.
        message: what was tried and what to do about it; empty when solved.
        cause: number of the event of `kb.log` that changed feasibility and so led to this planning; None if no such
            event did.
        number: 1 for the first planning; if the first record that is left has another, the ones before are forgotten.
    """

    at_s: float
    reason: str
    outcome: Outcome
    steps: tuple[Step, ...]
    engine: str
    message: str = ""
    cause: int | None = None
    number: int = 0

    def added_to(
        self, plans: "tuple[PlanRecord, ...]", most: int = MEMORY
    ) -> "tuple[PlanRecord, ...]":
        """Return records with this one as the last, numbered; of more than `most`, the oldest are left out."""
        return *plans[max(0, len(plans) + 1 - most) :], replace(
            self, number=plans[-1].number + 1 if plans else 1
        )

    def _repr_html_(self) -> str:
        steps = "".join(f"<li>{escape(str(step))}</li>" for step in self.steps)
        said = f"{self.outcome} by {self.engine}, asked at {self.at_s:g} s: {self.reason} {self.message}"
        return f"<p>{escape(said)}</p><ol>{steps}</ol>"


@dataclass(frozen=True)
class _DeadEnd:
    """A problem without a plan, why it has none, and the time from which it is tried again in any case [s]."""

    domain: Domain
    problem: Problem
    why: str
    until_s: float


class Replanning:
    """Requests plans as the policy allows, and finds out why there is none."""

    BOOKKEEPING = "records _last_asked_s _soft"

    def __init__(
        self,
        goals: Goals,
        monitor: PlanMonitor,
        client: PlannerClient,
        policy: ReplanningPolicy,
        clash: Clash | None,
        memory: int,
    ) -> None:
        if type(memory) is not int or memory < 1:
            raise PlannerSettingError(
                f"memory is {memory!r}, expected a whole number of plannings from 1"
            )
        self._memory = memory
        self._goals, self._monitor, self._client, self._policy, self._clash = (
            goals,
            monitor,
            client,
            policy,
            clash,
        )
        self._effects, self._clock = monitor.effects, client.clock
        self.matters = Relevance(monitor.effects.domain, goals).matters
        self._last_asked_s = -inf
        self._soft: SoftGoals | None = None
        self._wanted: Decision | None = None
        self._diagnosis: tuple[Problem, str, Diagnosis] | None = None
        self._asked_in = monitor.effects.domain
        self._dead_end: _DeadEnd | None = None
        self._was_stale = False
        self.setbacks, self._in_vain = (
            Setbacks(client.clock, policy),
            Setbacks(client.clock, policy),
        )
        self.records: tuple[PlanRecord, ...] = ()

    def wait_no_more(self) -> None:
        """Forget the time of the last request, and all failures."""
        self._last_asked_s = -inf
        self.setbacks.clear()
        self._in_vain.clear()

    @property
    def is_busy(self) -> bool:
        return self._wanted is not None or self._client.is_under_way

    def why_no_plan(self, state: State) -> str | None:
        """Return why there is no plan from a state, if that is known already; None if the planner must be asked."""
        dead_end = self._dead_end
        if (
            dead_end is None
            or dead_end.domain is not self._effects.domain
            or self._clock() >= dead_end.until_s
        ):
            return None
        is_known = self._is_same(dead_end.problem.state, state) and self._monitor.is_no_easier(
            dead_end.problem
        )
        return dead_end.why if is_known else None

    @property
    def had_no_plan(self) -> bool:
        return self._dead_end is not None

    def want(self, decision: Decision) -> None:
        """Note that a plan is wanted; if it is needed, the planning that is under way is given up.

        After trouble, the planner gets no requests for plans that are not needed during longer and longer pauses.
        """
        is_kept = self._wanted is not None and self._wanted.is_needed
        if is_kept or (not decision.is_needed and self._in_vain.wait_s(None)):
            return
        self._wanted = decision
        if decision.is_needed:
            self._client.give_up()
            self._diagnosis = None

    def goals_changed(self, *, is_needed: bool) -> None:
        """Restart planning that is under way with the new goals; forget that there was no plan."""
        self._dead_end = None
        if self._client.is_under_way:
            self._client.give_up()
            self._diagnosis = None
            self.want(Decision("the goals changed", is_needed))

    def ask_if_allowed(self, state: State, shares: Mapping[Step, float]) -> str | None:
        """Request the plan that is wanted, if any, unless it is too soon; return what to show as feedback."""
        if self._wanted is None:
            return None
        now_s = self._clock()
        left_s = max(
            self._last_asked_s + self._policy.at_most_every_s - now_s, self.setbacks.wait_s(None)
        )
        if left_s > 0.0 and not self._client.is_prepared(lambda: self._problem(state, shares)):
            return f"planning in {left_s:.2g} s: {self._wanted.reason}"
        decision, self._wanted = self._wanted, None
        self._asked_in = self._effects.domain
        self._client.ask(self._problem(state, shares), decision)
        self._last_asked_s, self._dead_end = now_s, None
        return f"planning: {decision.reason}"

    def _problem(self, state: State, shares: Mapping[Step, float]) -> Problem:
        """Return the problem for the planner; if there are soft goals, they are compiled into its domain."""
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
        """Give up wanted plans and planning under way; a known lack of a plan is kept."""
        self._client.give_up()
        self._wanted = self._diagnosis = None

    def take(self, state: State) -> tuple[PlanExecution, Decision] | None:
        """Take the answer; return the plan, or the safe step if there is none, with the decision that led to it."""
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
        record = (
            question.at_s,
            decision.reason,
            outcome,
            result.steps,
            result.engine,
            result.message,
            decision.cause,
        )
        self.records = PlanRecord(*record).added_to(self.records, self._memory)
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
            # asking again would give the same answer
            why = f"no plan: what {result.engine} gave cannot be done event by event: {wrong}"
            self._give_up(state, question.problem, why)
            return None
        return (
            self._without_plan(question, result, state, is_fresh=is_fresh)
            if decision.is_needed
            else None
        )

    def _without_plan(
        self, question: _Question, result: PlanningResult, state: State, *, is_fresh: bool
    ) -> tuple[PlanExecution, Decision] | None:
        """Start a diagnosis or a retry, or conclude; return the safe step as a plan if it can start."""
        outcome, domain, reason = (
            result.outcome,
            self._effects.domain,
            getattr(question.decision, "reason", ""),
        )
        why = f"no plan: {result.message or reason}"
        why = why if str(outcome) in why else f"no plan, {outcome}: {result.message or reason}"
        was_stale, self._was_stale = self._was_stale, not is_fresh
        if outcome.is_passing:  # it does not tell whether there is a plan
            count, is_over = self.setbacks.count(None) + 1, self.setbacks.add(None)
            left_s = self.setbacks.wait_s(None)
            if is_over:
                why = f"{why}; tried {count} times, again in {left_s:.3g} s at the earliest"
                self._give_up(state, question.problem, why, self._clock() + left_s)
            else:
                self.want(
                    Decision(
                        f"{outcome} after {reason}: retry {count} of {self._policy.retries}", True
                    )
                )
        elif not is_fresh:
            self.want(Decision("the state changed during planning", is_needed=True))
        elif outcome.is_trouble:
            self._conclude(state, question.problem, [why])
        else:
            goals = tuple(goal.expression for goal in self._goals.hard)
            asked = question.problem
            unsolved = Problem(
                domain, state, goals, asked.costs, until=asked.until, shares=asked.shares
            )
            self._diagnosis = unsolved, why, diagnosis(unsolved, self._goals.hard)
            self._diagnose(None, state)
        safe = result.safe_step
        # even if the state changes during every planning, the safe step is done
        is_due = (
            is_fresh or was_stale or outcome.is_passing
        ) and safe not in self.setbacks.left_out
        if safe is None or not is_due or missing_at_start(domain, safe, state) is not None:
            return None
        plan = PlanExecution.of(domain, PlanningResult(Outcome.SOLVED, (safe,)), ())
        return plan, Decision("there is no plan", is_needed=True)

    def _is_same(self, one: State, other: State) -> bool:
        """Whether two states are the same in everything that a plan or a goal may depend on."""
        return not any(map(self.matters, one ^ other))

    def _give_up(self, state: State, problem: Problem, why: str, until_s: float = inf) -> None:
        """Note that there is no plan with the numbers and forecasts of the request, which may have changed since.

        Planning is tried again when the pause of a step ends that is left out because it has failed.
        """
        out = self.setbacks.left_out
        for step in out:
            left_s = self.setbacks.wait_s(step)
            why += f"; {step} has failed {self.setbacks.count(step)} times and is left out for {left_s:.3g} s"
            until_s = min(until_s, self._clock() + left_s)
        self._dead_end = _DeadEnd(self._effects.domain, replace(problem, state=state), why, until_s)

    def _diagnose(self, answer: PlanningResult | None, state: State) -> None:
        """Continue the diagnosis or conclude it; if the state has changed in the meantime, replan instead."""
        assert self._diagnosis is not None
        problem, why, asking = self._diagnosis
        if problem.domain is not self._effects.domain or not self._is_same(problem.state, state):
            self._diagnosis = None
            self.want(Decision("the state changed", is_needed=True))
            return
        try:
            # a generator that has not started accepts no value
            self._client.ask(next(asking) if answer is None else asking.send(answer), None)
        except StopIteration as concluded:
            self._diagnosis = None
            self._conclude(state, problem, [why, *concluded.value])

    def _conclude(self, state: State, problem: Problem, why: Sequence[str]) -> None:
        self._give_up(state, problem, "; ".join(map(str, (*why, *self._effects.unmet))))
