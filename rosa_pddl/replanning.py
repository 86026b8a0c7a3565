"""Asks the planner for plans, and finds out why there is none."""

from collections.abc import Callable, Generator, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Future
from dataclasses import dataclass, replace
from math import inf
from numbers import Real
from typing import Protocol, TypeAlias

from rosa_pddl.domain import (
    Domain,
    GoalError,
    PlannerSettingError,
    PlanningBudgetError,
    State,
    Step,
    constants_in,
    head_of,
    names_in,
    nearest,
)
from rosa_pddl.plan_monitor import PlanExecution, PlanMonitor
from rosa_pddl.planner import wait_for_plan
from rosa_pddl.problem import Outcome, PlanningResult, Problem
from rosa_pddl.reader import Goal, conditions
from rosa_pddl.validate import goal_holds

# Sums of tick lengths may miss the due time by a rounding error; shorter times count as none [s].
_CLOCK_RESOLUTION_S = 1e-6
# Time beyond the planner's own time limit to wait for its answer, before it is given up [s].
_GRACE_S = 2.0
# The pause after a first failure, which doubles with each further one, and the longest pause [s].
_FIRST_PAUSE_S, _LONGEST_PAUSE_S = 0.2, 60.0
_MOST_RECORDS = 10_000


# ---------------------------------------------------------------- goals


class Goals:
    """The goals, in the order in which they were added; first those of the problem file.

    Each part of a conjunction is a goal of its own. Change goals between ticks, in the thread that
    ticks.

    Args:
        domain: what `load_domain` returned.

    Attributes:
        version: counts the changes.
    """

    def __init__(self, domain: Domain) -> None:
        self._domain = domain
        self._goals: dict[str, Goal] = {}
        self._gone: dict[str, None] = {}
        self.version = 0
        for text in domain.goals:
            self._goals |= self._read(text)

    @property
    def hard(self) -> tuple[Goal, ...]:
        """The goals that must be reached."""
        return tuple(goal for goal in self if not goal.is_soft)

    @property
    def soft(self) -> tuple[Goal, ...]:
        """The goals that a plan may give up."""
        return tuple(goal for goal in self if goal.is_soft)

    def add(self, text: str, worth: float | None = None) -> None:
        """Add a goal; if it exists already, it gets the new worth.

        Args:
            text: a condition such as `(inspected north)`.
            worth: how much more a plan may cost to reach the goal, in the unit of the plan's cost;
                None if it must be reached. Each part of a conjunction gets this worth.

        Raises:
            GoalError: `text` is not a string, or the worth is not positive.
            PddlError: the text is not PDDL.
            UnknownNameError: the text has a name that the domain does not have.
        """
        if worth is not None and not (isinstance(worth, Real) and 0.0 < worth < inf):
            message = f"{text} is worth {worth}, expected more than 0"
            raise GoalError(f"{message}; leave it out if it must be reached")
        self._set(self._goals | self._read(text, worth))

    def drop(self, text: str) -> None:
        """Remove a goal; each part of a conjunction is removed.

        Raises:
            GoalError: there is no such goal; other errors as in `add`.
        """
        goals = dict(self._goals)
        for goal in self._read(text):
            if goals.pop(goal, None) is None:
                raise GoalError(f"{goal} is not among the goals; {nearest(goal, goals)}")
        self._set(goals)

    def replace(self, *texts: str) -> None:
        """Replace all goals by these, which must be reached; raises as `add`."""
        goals = dict[str, Goal]()
        for text in texts:
            goals |= self._read(text)
        self._set(goals)

    def use(self, domain: Domain) -> None:
        """Switch to a domain with other objects; the goals of objects that are gone go, too."""
        self._domain = domain
        for text, goal in tuple(self._goals.items()):
            if not constants_in(goal.expression) <= domain.types.keys():
                del self._goals[text]
                self._gone[text] = None
        self.version += 1

    def told(self, outcome: str) -> str:
        """Return the words of an outcome, with the goals that are gone since the last one."""
        gone = ", ".join(self._gone)
        self._gone.clear()
        return f"{outcome}; gone with their objects: {gone}" if gone else outcome

    def _set(self, goals: dict[str, Goal]) -> None:
        self.version += goals != self._goals
        self._goals = goals

    def __iter__(self) -> Iterator[Goal]:
        return iter(tuple(self._goals.values()))

    def _read(self, text: str, worth: float | None = None) -> dict[str, Goal]:
        if not isinstance(text, str):
            message = f"{text!r} is no goal, expected a condition as text"
            raise GoalError(f"{message} such as '(inspected north)'")
        return {goal.text: goal for goal in conditions(self._domain, text, worth)}


def needed_by(domain: Domain, goals: Iterable[Goal]) -> set[str]:
    """Return the predicates and numbers on which a plan or a goal may depend."""
    needed = names_in(goal.expression for goal in goals)
    size = -1
    while size != len(needed):
        size = len(needed)
        for name, axioms in domain.axioms.items():
            if domain.signatures[name].name in needed:
                needed |= names_in(axiom.condition for axiom in axioms)
        for schema in domain.schema_of.values():
            if not needed.isdisjoint(effect.name for effect in schema.effects):
                needed |= names_in(schema.conditions)
                for effect in schema.effects:
                    needed |= names_in([effect.condition, effect.amount])
    return needed


# ---------------------------------------------------------------- the policy


@dataclass(frozen=True)
class ReplanningPolicy:
    """How often a plan executor replans, and how patient it is.

    A plan that no longer reaches the goals is always replaced. The conditions of running steps are
    always watched, and a step is stopped as soon as one of its conditions does not hold. Other
    steps go on while a new plan is needed, and are kept if it starts with them.

    Args:
        at_most_every_s: shortest time between the starts of two plannings [s].
        retries: how often in a row a planner in trouble is asked again, and a failed step is
            planned again; the pause doubles each time. After that, planning fails, or plans leave
            out the step, until a pause of up to a minute is over.
        overrun: how many times its expected duration a step may take; then it is stopped and
            counts as failed.
        keep_required: whether the ROSA action of a step that has succeeded stays required until
            the next step starts, at most as long as the planner may take: no gap between steps.

    Raises:
        PlannerSettingError: a setting that makes no sense.
    """

    at_most_every_s: float = 0.2
    retries: int = 3
    overrun: float = inf
    keep_required: bool = True

    def __post_init__(self) -> None:
        for name in ("at_most_every_s", "retries"):
            value = getattr(self, name)
            if not 0.0 <= value < inf:
                raise PlannerSettingError(f"{name} is {value:g}, expected 0 or more")
        if not self.overrun > 1.0:
            raise PlannerSettingError(f"overrun is {self.overrun:g}, expected more than 1")


class RetryBackoff:
    """Counts failures in a row of each step, and of the planner (key None), with their pauses."""

    def __init__(self, clock: Callable[[], float], policy: ReplanningPolicy) -> None:
        self._clock = clock
        self._policy = policy
        self._failed: dict[Step | None, tuple[int, float]] = {}

    def add(self, what: Step | None, count: int = 0) -> bool:
        """Count one more failure and begin a pause; return whether all retries are used up."""
        count = max(count, self.count(what) + 1)
        # larger exponents would only overflow
        pause_s = min(_FIRST_PAUSE_S * 2.0 ** min(count - 1, 30), _LONGEST_PAUSE_S)
        self._failed[what] = count, self._clock() + pause_s
        return count > self._policy.retries

    def forget(self, what: Step | None) -> None:
        """Forget the failures."""
        self._failed.pop(what, None)

    def end_pauses(self) -> None:
        """End all pauses, but keep the counts."""
        self._failed = {what: (count, -inf) for what, (count, _) in self._failed.items()}

    def count(self, what: Step | None) -> int:
        """Return how often it failed in a row."""
        return self._failed.get(what, (0, 0.0))[0]

    def wait_s(self, what: Step | None) -> float:
        """Return how much of its pause is left [s]."""
        left_s = self._failed.get(what, (0, -inf))[1] - self._clock()
        return left_s if left_s > _CLOCK_RESOLUTION_S else 0.0

    @property
    def weights(self) -> Mapping[Step, int]:
        """The factor on each step's cost: the expected number of tries; 0 leaves it out."""
        weights = dict[Step, int]()
        for step, (count, _) in self._failed.items():
            if step is not None:
                is_over = count > self._policy.retries and self.wait_s(step)
                weights[step] = 0 if is_over else count + 1
        return weights


class PlansAhead(Protocol):
    """What the executor needs from a planner."""

    @property
    def timeout_s(self) -> float:
        """The planner's own time limit for an answer [s]."""

    def start(self, problem: Problem) -> "Future[PlanningResult]": ...


@dataclass(frozen=True)
class _Question:
    """A request to the planner; without a reason it is part of a diagnosis."""

    problem: Problem
    reason: str
    cause: int | None
    at_s: float
    future: "Future[PlanningResult]"


class PlannerClient:
    """Sends requests to a planner in the background, at most one at a time."""

    def __init__(
        self, planner: PlansAhead, clock: Callable[[], float], delay_s: float | None
    ) -> None:
        if delay_s is not None and not 0.0 <= delay_s < inf:
            raise PlannerSettingError(f"delay_s is {delay_s:g} s, expected 0 or more, or None")
        self._planner = planner
        self.clock = clock
        self._delay_s = delay_s
        self._question: _Question | None = None

    @property
    def is_under_way(self) -> bool:
        """Whether a question is open."""
        return self._question is not None

    def ask(self, problem: Problem, reason: str = "", cause: int | None = None) -> None:
        """Ask for a plan; an open question is given up."""
        self.give_up()
        try:
            future = self._planner.start(problem)
        except Exception as error:  # a planner must not stop the tree; its error is its answer
            future = Future()
            future.set_exception(error)
        self._question = _Question(problem, reason, cause, self.clock(), future)

    @property
    def has_answer(self) -> bool:
        """Whether the answer is there and due."""
        question = self._question
        return question is not None and self._is_due(question) and question.future.done()

    def take(self) -> tuple[_Question, PlanningResult]:
        """Return the request and its answer."""
        question = self._question
        assert question is not None
        result = self._answer(question)
        self.give_up()
        return question, result

    def catch_up(self) -> None:
        """Wait for an answer that is due, at most a little longer than the planner may take."""
        if self._question is None or self._delay_s is None or not self._is_due(self._question):
            return
        try:
            wait_for_plan(self._question.future, self._planner.timeout_s + _GRACE_S)
        except PlanningBudgetError:
            raise
        except Exception:  # it is reported by name when the answer is taken
            return

    def give_up(self) -> None:
        """Give up the open question."""
        if self._question is not None:
            self._question.future.cancel()
        self._question = None

    def _is_due(self, question: _Question) -> bool:
        return self.clock() - question.at_s >= (self._delay_s or 0.0) - _CLOCK_RESOLUTION_S

    def _answer(self, question: _Question) -> PlanningResult:
        try:
            return question.future.result()
        except Exception as error:  # a planner of the user's own may raise anything
            message = f"{type(error).__name__}: {error}"
            engine = type(self._planner).__name__
            return PlanningResult(Outcome.ENGINE_CRASHED, engine=engine, message=message)


# ---------------------------------------------------------------- why there is no plan


@dataclass(frozen=True)
class Reasons:
    """Why there is no plan, in sentences, and the goals that can be reached together."""

    sentences: list[str]
    reachable: tuple[Goal, ...] = ()


Diagnosis: TypeAlias = Generator[Problem, PlanningResult, Reasons]
"""Yields the next problem for the planner, receives its result, and finally returns reasons."""


def diagnosis(problem: Problem, goals: Sequence[Goal]) -> Diagnosis:
    """Ask more problems after there was no plan, to find out why, as far as the planner can tell.

    It asks for the goals, one more each time, and leaves out those that cannot be reached with
    the others; what holds already, such as a limit, must stay so. Then it asks for all goals with
    every action feasible, and without forecasts.
    """
    domain = problem.domain.with_numbers(problem.costs)
    holding = [goal for goal in goals if goal_holds(domain, problem.state, [goal.expression])]
    reachable = list(holding)
    missed = list[str]()
    for goal in goals if len(goals) > 1 else ():
        if goal in holding:
            continue
        together = [other.expression for other in (*reachable, goal)]
        outcome = (yield replace(problem, goals=tuple(together))).outcome
        if outcome.is_solved:
            reachable.append(goal)
        elif outcome.is_unsolvable:
            missed.append(goal.text)
    if len(goals) == 1:
        missed = [goals[0].text]
    sentences = [f"out of reach: {', '.join(missed)}"] if missed else []
    unfeasible = {a: name for a, name in domain.feasibility.items() if a not in problem.state}
    if unfeasible:
        outcome = (yield replace(problem, state=problem.state.union(unfeasible))).outcome
        if outcome.is_solved:
            names = ", ".join(unfeasible.values())
            sentence = f"unfeasible now: {names}; there would be a plan if they were feasible"
            sentences.append(sentence)
        elif outcome is Outcome.UNSOLVABLE_PROVEN:
            sentences.append("there would be no plan even if every action were feasible")
    if problem.until:
        lasting = [f"{atom} for {left_s:.3g} s" for atom, left_s in problem.until.items()]
        if (yield replace(problem, until={})).outcome.is_solved:
            what = f"what is forecast to hold no longer: {', '.join(lasting)}"
            sentences.append(f"there would be a plan without {what}")
    return Reasons(sentences, tuple(reachable))


@dataclass(frozen=True)
class PlanRecord:
    """The record of one planning.

    Args:
        at_s: when the plan was requested [s, the executor's clock].
        reason: why it was requested, in words.
        outcome: how it ended.
        steps: the plan; empty unless solved.
        engine: the strategy that answered.
        message: what was tried and what to do about it; with a plan, what it assumes.
        cause: number of the event of `kb.log` that changed feasibility and so led to this
            planning; None if no such event did.
        number: 1 for the first planning; if the first record that is left has another, the ones
            before are forgotten.
    """

    at_s: float
    reason: str
    outcome: Outcome
    steps: tuple[Step, ...]
    engine: str
    message: str = ""
    cause: int | None = None
    number: int = 0

    def added_to(self, plans: "tuple[PlanRecord, ...]") -> "tuple[PlanRecord, ...]":
        """Return records with this one as the last, numbered; the oldest are left out."""
        number = plans[-1].number + 1 if plans else 1
        return *plans[1 - _MOST_RECORDS :], replace(self, number=number)


@dataclass(frozen=True)
class _DeadEnd:
    """A problem without a plan, why it has none, and when it is tried again in any case [s]."""

    problem: Problem
    why: str
    until_s: float


class Replanning:
    """Requests plans as the policy allows, and finds out why there is none.

    Goals that cannot be reached are left out: the others are done first, and then these are tried
    once more.

    Attributes:
        left_out: the goals that are left out now.
    """

    def __init__(
        self, goals: Goals, monitor: PlanMonitor, client: PlannerClient, policy: ReplanningPolicy
    ) -> None:
        self._goals = goals
        self._monitor = monitor
        self._client = client
        self._policy = policy
        self._effects = monitor.effects
        self._clock = client.clock
        self._last_asked_s = -inf
        self._wanted: tuple[str, int | None] | None = None
        self._diagnosis: tuple[Problem, str, Diagnosis] | None = None
        self._dead_end: _DeadEnd | None = None
        self.backoff = RetryBackoff(client.clock, policy)
        self.left_out: tuple[Goal, ...] = ()
        self._is_last_try = False
        self.records: tuple[PlanRecord, ...] = ()

    @property
    def hard(self) -> tuple[Goal, ...]:
        """The goals that must be reached and are not left out."""
        return tuple(goal for goal in self._goals.hard if goal not in self.left_out)

    @property
    def is_busy(self) -> bool:
        """Whether a plan is wanted, or a question is open."""
        return self._wanted is not None or self._client.is_under_way

    def why_no_plan(self, state: State) -> str | None:
        """Return why there is no plan from a state, if that is known.

        None if the planner is asked.
        """
        dead_end = self._dead_end
        if dead_end is None or self._clock() >= dead_end.until_s:
            return None
        is_same = self._is_same(dead_end.problem, state)
        return dead_end.why if is_same and self._monitor.is_no_easier(dead_end.problem) else None

    @property
    def had_no_plan(self) -> bool:
        """Whether the last planning found that there is no plan."""
        return self._dead_end is not None

    def want(self, reason: str, cause: int | None = None) -> None:
        """Note that a plan is wanted, and what caused that; give up the planning under way."""
        self._wanted = self._wanted or (reason, cause)
        self._client.give_up()
        self._diagnosis = None

    def forget_failures(self) -> None:
        """Forget that there was no plan, and which goals are left out."""
        self._dead_end = None
        self.left_out = ()
        self._is_last_try = False

    def try_left_out(self) -> None:
        """Try the goals that are left out once more, after all others are done."""
        names = ", ".join(goal.text for goal in self.left_out)
        self.left_out = ()
        self._is_last_try = True
        self.backoff.end_pauses()
        self.want(f"the other goals are reached; once more {names}")

    def ask_if_allowed(self, state: State, shares: Mapping[Step, float]) -> str | None:
        """Request the plan that is wanted, unless it is too soon; return what to show."""
        if self._wanted is None:
            return None
        reason, _ = self._wanted
        now_s = self._clock()
        left_s = self._last_asked_s + self._policy.at_most_every_s - now_s
        left_s = max(left_s, self.backoff.wait_s(None))
        if left_s > _CLOCK_RESOLUTION_S:
            return f"planning in {left_s:.2g} s: {reason}"
        until = self._monitor.until()
        problem = Problem(
            domain=self._effects.domain,
            state=state,
            goals=tuple(goal.expression for goal in self.hard),
            costs=self._monitor.belief.numbers,
            weights=self.backoff.weights,
            until=until,
            shares=shares if until else {},
            soft=self._goals.soft,
        )
        self._client.ask(problem, *self._wanted)
        self._wanted = self._dead_end = None
        self._last_asked_s = now_s
        return f"planning: {reason}"

    def forget(self) -> None:
        """Give up wanted plans and planning under way; a known lack of a plan is kept."""
        self._client.give_up()
        self._wanted = self._diagnosis = None

    def take(self, state: State) -> PlanExecution | None:
        """Take the answer; return the plan, if there is one."""
        question, result = self._client.take()
        problem = question.problem
        if not question.reason:
            self._diagnose(result, state)
            return None
        domain = self._effects.domain
        outcome = result.outcome
        if outcome.is_solved:
            assumed = self._effects.assumptions(result.steps, state)
            result = replace(result, message="; ".join(assumed))
        record = PlanRecord(
            at_s=question.at_s,
            reason=question.reason,
            outcome=outcome,
            steps=result.steps,
            engine=result.engine,
            message=result.message,
            cause=question.cause,
        )
        self.records = record.added_to(self.records)
        if not outcome.is_passing:
            self.backoff.forget(None)
        is_fresh = self._is_same(problem, state)
        if not outcome.is_solved:
            self._without_plan(question, result, state)
            return None
        plan = PlanExecution.of(domain, result, self.hard)
        if self._goals.soft:
            plan = self._monitor.aimed(plan, problem.state, self.hard, self._goals.soft)
        wrong = plan.prediction(domain, state).flaw if is_fresh else None
        if wrong is None:
            return plan
        # asking again would give the same answer
        why = f"no plan: what {result.engine} gave cannot be done event by event: {wrong}"
        self._give_up(replace(problem, state=state), why)
        return None

    def _without_plan(self, question: _Question, result: PlanningResult, state: State) -> None:
        """Start a diagnosis or a retry, or conclude."""
        problem = question.problem
        reason = question.reason
        outcome = result.outcome
        why = f"no plan: {result.message or reason}"
        if str(outcome) not in why:
            why = f"no plan, {outcome}: {result.message or reason}"
        if outcome.is_passing:  # it does not tell whether there is a plan
            is_over = self.backoff.add(None)
            count = self.backoff.count(None)
            if is_over:
                left_s = self.backoff.wait_s(None)
                why = f"{why}; tried {count} times, again in {left_s:.3g} s at the earliest"
                self._give_up(replace(problem, state=state), why, self._clock() + left_s)
            else:
                text = f"{outcome} after {reason}"
                self.want(f"{text}: retry {count} of {self._policy.retries}")
        elif not self._is_same(problem, state):
            self.want("the state changed during planning")
        elif outcome.is_trouble:
            self._conclude(replace(problem, state=state), [why])
        else:
            unsolved = replace(problem, soft=())
            self._diagnosis = unsolved, why, diagnosis(unsolved, self.hard)
            self._diagnose(None, state)

    def _is_same(self, problem: Problem, state: State) -> bool:
        """Whether a state is that of a problem in everything that a plan may depend on."""
        domain = self._effects.domain
        changed = {head_of(fact) for fact in state ^ problem.state}
        is_relevant = changed and not changed.isdisjoint(needed_by(domain, self._goals))
        return problem.domain is domain and not is_relevant

    def _give_up(self, problem: Problem, why: str, until_s: float = inf) -> None:
        """Note that there is no plan.

        Planning is tried again when the pause of a step ends that is left out as it has failed.
        """
        for step, weight in self.backoff.weights.items():
            if not weight:
                left_s = self.backoff.wait_s(step)
                count = self.backoff.count(step)
                why += f"; {step} has failed {count} times and is left out for {left_s:.3g} s"
                until_s = min(until_s, self._clock() + left_s)
        self._dead_end = _DeadEnd(problem, self._goals.told(why), until_s)

    def _diagnose(self, answer: PlanningResult | None, state: State) -> None:
        """Continue the diagnosis or conclude it; if the state has changed meanwhile, replan."""
        assert self._diagnosis is not None
        problem, why, asking = self._diagnosis
        if not self._is_same(problem, state):
            self.want("the state changed")
            return
        try:
            # a generator that has not started accepts no value
            self._client.ask(next(asking) if answer is None else asking.send(answer))
        except StopIteration as concluded:
            self._diagnosis = None
            reasons: Reasons = concluded.value
            done = self._monitor.holding(reasons.reachable, state)
            if not self._is_last_try and len(done) < len(reasons.reachable):
                self._leave_out([goal for goal in self.hard if goal not in reasons.reachable])
            else:
                self._conclude(replace(problem, state=state), [why, *reasons.sentences])

    def _leave_out(self, goals: Sequence[Goal]) -> None:
        """Leave out goals for now, and plan for the others."""
        self.left_out = (*self.left_out, *goals)
        names = ", ".join(goal.text for goal in goals)
        self.want(f"{names} out of reach for now; the others first")

    def _conclude(self, problem: Problem, why: Sequence[str]) -> None:
        sentences = [*why, *map(str, self._effects.unmet)]
        if self.left_out:
            sentences.append(f"left out: {', '.join(goal.text for goal in self.left_out)}")
        self._give_up(problem, "; ".join(sentences))
