"""Executes plans step by step with py_trees behaviours, and plans anew when the world is not what the plan needs."""

from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import Future, wait
from dataclasses import dataclass, replace
from typing import Protocol

from py_trees.behaviour import Behaviour
from py_trees.common import Status

from rosa_pddl.domain import Domain, Feasibility, State, Step
from rosa_pddl.exceptions import MissingBehaviourError, nearest
from rosa_pddl.planning import Outcome, Planner, PlanningResult
from rosa_pddl.problem import Problem, feasible_atoms, initial_state, sensed_into, without_feasibility
from rosa_pddl.validate import because, ended, flaw, goal_holds, missing_at_end, missing_meanwhile, started

# Sums of tick lengths miss the due time by rounding; no clock of ours tells less than this apart [s].
_CLOCK_RESOLUTION_S = 1e-6
# A planner keeps its own time limit; this much more is waited before it is given up [s].
_GRACE_S = 2.0

Factory = Callable[[Step], Behaviour]


class PlansAhead(Protocol):
    """What the executor needs of a planner."""

    @property
    def timeout_s(self) -> float:
        """After this long the planner gives up by itself [s]."""

    def start(self, problem: Problem) -> "Future[PlanningResult]":
        """Begin to plan, without waiting."""


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
class _Request:
    future: "Future[PlanningResult]"
    state: State
    at_s: float
    due_s: float
    reason: str

    def is_due(self, now_s: float) -> bool:
        return now_s >= self.due_s - _CLOCK_RESOLUTION_S


class PlanExecutor(Behaviour):
    """Plans towards the goal of a domain's problem and executes the plan, one step at a time.

    It is RUNNING while it plans (nothing else runs then) and while a step runs, SUCCESS when the goal holds, and
    FAILURE when there is no plan; ticked again after that it plans anew only if something has changed.

    It plans anew when the running step needs what does not hold any more, when a step fails or cannot start, and when
    the rest of the plan does not lead to the goal any more. Feasibility is always the knowledge base's: the effects of
    a finished step are believed until sensed otherwise, those on `action_feasible` never.

    Args:
        name: of the behaviour.
        kb: says which ROSA actions are feasible.
        domain: what `load_domain` returned.
        behaviours: for each PDDL action, what makes the behaviour of a step.
        sense: returns the facts that are sensed now, by text such as `(lit room)`; others stay as they were.
        clock: returns the time [s].
        planner: plans beside the ticks; by default Fast Downward.
        delay_s: the answer of the planner is taken this long after the request, whatever it took, so that a simulation
            is the same each time [s]; None to take it as soon as it is there.
    """

    def __init__(
        self,
        name: str,
        *,
        kb: Feasibility,
        domain: Domain,
        behaviours: Mapping[str, Factory],
        sense: Callable[[], Mapping[str, bool]],
        clock: Callable[[], float],
        planner: PlansAhead | None = None,
        delay_s: float | None = 0.2,
    ) -> None:
        super().__init__(name)
        domain.check(kb)
        _check_behaviours(domain, behaviours)
        self._kb = kb
        self._domain = domain
        self._factories = dict(behaviours)
        self._sense = sense
        self._clock = clock
        self._planner: PlansAhead = planner if planner is not None else Planner()
        self._delay_s = delay_s
        self._setup_arguments: dict[str, object] = {}
        self._believed = without_feasibility(domain, initial_state(domain))
        self._records: list[PlanRecord] = []
        self._request: _Request | None = None
        self._step: Step | None = None
        self._undo: tuple[State, State] = (frozenset(), frozenset())
        self._rest: tuple[Step, ...] = ()
        self._found_valid: State | None = None
        self._hopeless: tuple[State, str] | None = None
        self._ticked: list[Behaviour] = []

    @property
    def plans(self) -> tuple[PlanRecord, ...]:
        """Every planning that was answered: when, why, with what result. One that was interrupted has no result."""
        return tuple(self._records)

    @property
    def current_step(self) -> Step | None:
        """The step that runs."""
        return self._step

    @property
    def remaining_steps(self) -> tuple[Step, ...]:
        """The steps of the plan that come after the current one."""
        return self._rest

    def catch_up(self) -> None:
        """Wait for an answer of the planner that is due by now.

        Call it when the clock has moved on and before the tick: then a tick never waits and yet finds each answer that
        is due. A planner that is later than its own time limit allows counts as out of time.
        """
        request = self._request
        if request is None or self._delay_s is None or not request.is_due(self._clock()):
            return
        limit_s = self._planner.timeout_s + _GRACE_S
        finished, _ = wait([request.future], timeout=limit_s)
        if not finished:
            request.future.cancel()
            engine = str(getattr(self._planner, "engine", type(self._planner).__name__))
            message = f"{engine} gave no answer in {limit_s:g} s of waiting; allow more time or ask for less"
            late: Future[PlanningResult] = Future()
            late.set_result(PlanningResult(Outcome.OUT_OF_TIME, engine=engine, message=message))
            self._request = replace(request, future=late)

    # ---------------------------------------------------------------- hooks of py_trees

    def setup(self, **kwargs: object) -> None:
        """Keep the arguments for the behaviour of each step; called once before the first tick."""
        self._setup_arguments = kwargs

    def initialise(self) -> None:
        """Forget the plan of the last round, keep what is believed; called on the first tick of a round."""
        self._drop_plan()

    def tick(self) -> Iterator[Behaviour]:
        """Tick, and show visitors the nodes of the running step too."""
        for node in super().tick():
            yield from self._ticked
            yield node

    def update(self) -> Status:
        """Take the next decision; called on each tick, never waits."""
        self._ticked = []
        try:
            return self._advance()
        except Exception:
            self._drop_plan()
            raise

    def terminate(self, new_status: Status) -> None:
        """Stop the running step and forget the planning; called when the round ends or is interrupted."""
        self._drop_plan()

    def shutdown(self) -> None:
        """Stop as if interrupted; called when the tree is shut down."""
        if self.status == Status.RUNNING:
            self.stop(Status.INVALID)
        self._drop_plan()

    def tip(self) -> Behaviour | None:
        """Return the node that ran last: that of the step, if one runs."""
        return self.children[0].tip() if self.children else super().tip()

    # ---------------------------------------------------------------- one tick

    def _advance(self) -> Status:
        state = self._observe()
        if self._step is not None:
            return self._go_on(self._step, state)
        if goal_holds(self._domain, state):
            return self._reached()
        if self._request is not None:
            return self._await_plan(self._request, state)
        if self._hopeless is not None and self._hopeless[0] == state:
            self.feedback_message = self._hopeless[1]
            return Status.FAILURE
        return self._plan_anew("the state changed" if self._hopeless else "start", state)

    def _observe(self) -> State:
        """Take in what is sensed; return what is believed then, with the feasibility of the knowledge base."""
        self._believed = without_feasibility(self._domain, sensed_into(self._domain, self._believed, self._sense()))
        return self._believed | feasible_atoms(self._domain, self._kb)

    def _reached(self) -> Status:
        self._forget_request()
        self.feedback_message = "the goal holds"
        return Status.SUCCESS

    # ---------------------------------------------------------------- planning

    def _plan_anew(self, reason: str, state: State) -> Status:
        self._drop_plan()
        self._hopeless = None
        now = self._clock()
        future = self._planner.start(Problem(self._domain, state))
        self._request = _Request(future, state, now, now + (self._delay_s or 0.0), reason)
        self.feedback_message = f"planning: {reason}"
        return Status.RUNNING

    def _await_plan(self, request: _Request, state: State) -> Status:
        if not request.is_due(self._clock()) or not request.future.done():
            return Status.RUNNING
        result = _answer(request.future)
        self._request = None
        outcome, steps = result.outcome, result.steps
        self._records.append(PlanRecord(request.at_s, request.reason, outcome, steps, result.engine, result.message))
        if result.outcome.is_solved:
            self._rest = result.steps
            return self._start_next(state)
        if state != request.state:
            return self._plan_anew("the state changed during planning", state)
        self._hopeless = (state, f"no plan, {result.outcome}: {result.message or request.reason}")
        self.feedback_message = self._hopeless[1]
        return Status.FAILURE

    # ---------------------------------------------------------------- executing

    def _start_next(self, state: State) -> Status:
        while not goal_holds(self._domain, state):
            wrong = flaw(self._domain, self._rest, state)
            if wrong is not None:
                return self._plan_anew(wrong, state)
            step = self._rest[0]
            self._begin(step, state)
            status = self._tick_step(step)
            if status is not None:
                return status
            state = self._observe()
        return self._reached()

    def _go_on(self, step: Step, state: State) -> Status:
        wrong = self._broken(step, state)
        if wrong is not None:
            return self._plan_anew(wrong, self._abandon_step())
        status = self._tick_step(step)
        return status if status is not None else self._start_next(self._observe())

    def _broken(self, step: Step, state: State) -> str | None:
        """Why the running step and the rest of the plan will not do any more, in words."""
        missing = missing_meanwhile(self._domain, step, state)
        if missing is not None:
            return because(self._domain, step, missing, verb="became")
        if state == self._found_valid:
            return None
        self._found_valid = state
        return flaw(self._domain, self._rest, ended(self._domain, step, state))

    def _begin(self, step: Step, state: State) -> None:
        before = self._believed
        self._believed = without_feasibility(self._domain, started(self._domain, step, state))
        self._undo = (before - self._believed, self._believed - before)
        self._step, self._rest = step, self._rest[1:]
        self._found_valid = None
        self.feedback_message = str(step)
        child = self._factories[step.schema](step)
        for node in child.iterate():
            node.setup(**self._setup_arguments)
        child.parent = self
        self.children = [child]

    def _tick_step(self, step: Step) -> Status | None:
        """Tick the step's behaviour; None if the step has ended well, what to return otherwise."""
        child = self.children[0]
        try:
            self._ticked += list(child.tick())
            status, text = child.status, child.feedback_message
        except Exception as error:  # whatever a step's behaviour raises is that step's failure, not the tree's
            _stop(child)
            status, text = Status.FAILURE, f"{type(error).__name__}: {error}"
        if status == Status.RUNNING:
            return status
        reason = self._conclude(step) if status == Status.SUCCESS else ": ".join(filter(None, [f"{step} failed", text]))
        return None if reason is None else self._plan_anew(reason, self._abandon_step())

    def _conclude(self, step: Step) -> str | None:
        """Believe the effects of a step that succeeded; or say why it cannot have."""
        state = self._observe()
        missing = missing_at_end(self._domain, step, state)
        if missing is not None:
            return f"{step} ended although {missing} does not hold"
        self._believed = without_feasibility(self._domain, ended(self._domain, step, state))
        self._undo = (frozenset(), frozenset())
        self._release_child()
        return None

    def _abandon_step(self) -> State:
        """Stop the running step and take back what was believed because it had started; returns the state."""
        self._take_back()
        return self._observe()

    def _take_back(self) -> None:
        taken, given = self._undo
        self._believed = (self._believed | taken) - given
        self._undo = (frozenset(), frozenset())
        self._release_child()

    def _release_child(self) -> None:
        """Stop the step's behaviour if it still runs, and let go of it."""
        children, self.children, self._step = self.children, [], None
        for child in children:
            if child.status == Status.RUNNING:
                _stop(child)
            for node in child.iterate():
                node.shutdown()
            child.parent = None

    def _drop_plan(self) -> None:
        self._rest = ()
        self._found_valid = None
        self._forget_request()
        if self._step is not None:
            self._take_back()

    def _forget_request(self) -> None:
        if self._request is not None:
            self._request.future.cancel()
            self._request = None


def _check_behaviours(domain: Domain, behaviours: Mapping[str, Factory]) -> None:
    for schema in domain.schemas:
        if schema not in behaviours:
            given = ", ".join(sorted(behaviours)) or "none"
            message = f"no behaviour for the PDDL action {schema!r} of {domain.file}; given: {given}"
            raise MissingBehaviourError(f"{message} ({nearest(schema, behaviours)})")


def _stop(child: Behaviour) -> None:
    """Stop a behaviour for good: one that raises in its `terminate` must not keep the executor from going on."""
    try:
        child.stop(Status.INVALID)
    except Exception as error:
        child.logger.error(f"{type(error).__name__} in terminate: {error}")
        for node in child.iterate():
            node.status = Status.INVALID


def _answer(future: "Future[PlanningResult]") -> PlanningResult:
    try:
        return future.result()
    except Exception as error:  # a planner of the user's own may raise anything
        return PlanningResult(Outcome.ENGINE_CRASHED, message=f"{type(error).__name__}: {error}")
