"""Executes plans with py_trees behaviours, and replans when the world or the goals no longer fit the plan."""

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import replace

from py_trees.behaviour import Behaviour
from py_trees.common import Status

from rosa_pddl.belief import (
    Belief,
    ExpectedEffects,
    FeasibilityEvents,
    LastingFeasibility,
    Sense,
    UnmetEffect,
)
from rosa_pddl.domain import Domain, Feasibility, State, Step
from rosa_pddl.exceptions import MissingBehaviourError, UnknownNameError, nearest
from rosa_pddl.goals import Goals
from rosa_pddl.plan_monitor import PlanExecution, PlanMonitor, shared_components
from rosa_pddl.planner import Planner
from rosa_pddl.problem import Problem, lock_of, unlock, with_object, without_object
from rosa_pddl.replanning import (
    MEMORY,
    Decision,
    PlannerClient,
    PlanningState,
    PlanRecord,
    PlansAhead,
    Replanning,
    ReplanningPolicy,
    decide,
    news_of,
)
from rosa_pddl.syntax import conditions
from rosa_pddl.validate import StepEvent, because, goal_holds, missing_at_end, missing_meanwhile

Factory = Callable[[Step], Behaviour]

# One tick takes at most this many answers of a planner that answers at once.
_MOST_ROUNDS = 8


class RunningStep:
    """A running step, with its number in the plan that is executed.

    The executor lists it before `begin` makes its behaviour, so that the executor can release it after an interrupt at
    any instant. If an interrupt stops `release` itself, `release` may be called again.
    """

    BOOKKEEPING = "began_s"

    def __init__(self, step: Step, number: int, began_s: float) -> None:
        self.step, self.number, self.began_s = step, number, began_s
        self.behaviour: Behaviour | None = None
        self._is_midway = False
        self._set_up: list[Behaviour] = []

    def begin(self, factory: Factory, parent: Behaviour, arguments: Mapping[str, object]) -> None:
        """Make the behaviour and set it up; an error of the factory or of `setup` gets a note that names the step."""
        try:
            made = factory(self.step)
            if not isinstance(made, Behaviour):
                message = f"for {self.step} what was given for {self.step.schema!r} made {made!r}"
                raise MissingBehaviourError(f"{message}, expected a py_trees behaviour")
            self.behaviour = made
            for node in made.iterate():
                self._set_up.append(node)
                node.setup(**arguments)
        except Exception as error:
            error.add_note(f"it was raised when the behaviour of {self.step} was made")
            raise
        made.parent = parent

    def tick(self) -> tuple[Status, str, list[Behaviour]]:
        """Tick the behaviour; return its status, its feedback message and the nodes that were ticked.

        An exception in the behaviour of a step fails the step, never the tree.
        """
        assert self.behaviour is not None
        ticked: list[Behaviour] = []
        self._is_midway = True
        try:
            ticked.extend(self.behaviour.tick())
        except Exception as error:
            self._stop(self.behaviour)
            return Status.FAILURE, f"{type(error).__name__}: {error}", ticked
        self._is_midway = False
        return self.behaviour.status, self.behaviour.feedback_message, ticked

    def release(self) -> None:
        if self.behaviour is not None:
            if self._is_midway or self.behaviour.status == Status.RUNNING:
                self._stop(self.behaviour)
            self.behaviour.parent = None
        while self._set_up:
            node = self._set_up[-1]
            try:
                node.shutdown()
            except Exception as error:  # the other nodes must be released all the same
                node.logger.error(f"{type(error).__name__} in shutdown of {self.step}: {error}")
            self._set_up.pop()

    def _stop(self, behaviour: Behaviour) -> None:
        # if an interrupt cut a tick short, nodes below may have begun work although they are not RUNNING yet
        was_midway, self._is_midway = self._is_midway, True
        for node in behaviour.iterate() if was_midway else (behaviour,):
            try:
                node.stop(Status.INVALID)
            except Exception as error:  # the executor must go on all the same
                node.logger.error(f"{type(error).__name__} in terminate of {self.step}: {error}")
                node.status = Status.INVALID
        self._is_midway = False


def _check_factories(domain: Domain, behaviours: Mapping[str, Factory]) -> None:
    given = ", ".join(sorted(behaviours)) or "none"
    for schema in domain.schemas:
        if schema not in behaviours:
            message = (
                f"no behaviour for the PDDL action {schema!r} of {domain.file}; given: {given}"
            )
            raise MissingBehaviourError(f"{message} ({nearest(schema, behaviours)})")
        if not callable(behaviours[schema]):
            message = f"no behaviour can be made for {schema!r} from {behaviours[schema]!r}"
            raise MissingBehaviourError(
                f"{message}; expected what makes one for each step, such as a lambda"
            )
    for name in behaviours:
        if name not in domain.schemas:
            message = (
                f"a behaviour is given for {name!r}, but {domain.file} has no such PDDL action"
            )
            raise UnknownNameError(f"{message}; {nearest(name, domain.schemas)}")


class PlanExecutor(Behaviour):
    """Plans for the goals and executes the plan: one step at a time, or in the causal order of a temporal plan.

    It is RUNNING while it plans and while steps run, SUCCESS when the goals hold, and FAILURE when there is no plan.
    After a FAILURE, the next tick plans again only if something has changed.

    docs/pddl.md says when it replans and what it believes.

    Args:
        name: name of the behaviour.
        kb: says which ROSA actions are feasible.
        domain: what `load_domain` returned.
        behaviours: for each PDDL action, a factory that makes the behaviour of a step.
        sense: returns what is sensed now: whether facts such as `(lit room)` hold, and the values of numeric facts that
            costs depend on, such as `{"(length a b)": 3.5}`; others keep their values. Called several times a tick.
        clock: returns the time [s].
        planner: plans in the background; by default Fast Downward.
        delay_s: the executor takes the planner's answer this long after the request [s], however long planning took, so
            that every run of a simulation is the same; None to take it as soon as it is there, in the tick of the
            request if the planner answers at once.
        policy: when to replan, and what happens to running steps meanwhile.
        memory: how many plannings `plans` keeps; the oldest are forgotten.

    Attributes:
        goals: the goals to reach; may be changed between ticks.

    Raises:
        PddlError: the knowledge base does not know a ROSA action of the domain.
        MissingBehaviourError: a PDDL action has no behaviour factory, or one that cannot be called.
        UnknownNameError: a behaviour is given for a PDDL action that the domain does not have.
    """

    BOOKKEEPING = (
        "_cause _took_s _findings _ticked _found_valid _factories _setup_arguments _policy"
    )

    def __init__(
        self,
        name: str,
        *,
        kb: Feasibility,
        domain: Domain,
        behaviours: Mapping[str, Factory],
        sense: Sense,
        clock: Callable[[], float],
        planner: PlansAhead | None = None,
        delay_s: float | None = 0.2,
        policy: ReplanningPolicy | None = None,
        memory: int = MEMORY,
    ) -> None:
        super().__init__(name)
        self._findings = domain.check(kb)
        _check_factories(domain, behaviours)
        self.goals = Goals(domain)
        self._domain, self._factories = domain, dict(behaviours)
        self._policy = policy or ReplanningPolicy()
        self._owns_planner = planner is None
        self._planner: PlansAhead = Planner() if planner is None else planner
        self._belief = Belief(domain, kb, sense)
        self._effects = ExpectedEffects(domain, kb)
        self._feasibility = FeasibilityEvents(domain, kb)
        forecasts = kb.forecasts if isinstance(kb, LastingFeasibility) else dict
        self._monitor = PlanMonitor(self._effects, self._belief, forecasts)
        self._client = PlannerClient(self._planner, clock, delay_s)
        clash = shared_components(kb) if self._policy.side_by_side else None
        self._replanning = Replanning(
            self.goals, self._monitor, self._client, self._policy, clash, memory
        )
        self._setbacks = self._replanning.setbacks
        self._setup_arguments: dict[str, object] = {}
        self._running: list[RunningStep] = []
        self._ended_meanwhile: list[Step] = []
        self._plan: PlanExecution | None = None
        self._found_valid: tuple[PlanExecution, PlanningState] | None = None
        self._seen_goals = self.goals.version
        self._expected: PlanningState | None = None
        self._ticked: list[Behaviour] = []
        self._cause: int | None = None
        self._clock = clock
        self._took_s: dict[str, float] = {}
        self._switches = 0
        self._is_midway = False

    @property
    def state(self) -> State:
        """The state as it is believed now: facts, numbers such as `(= (fuel rover) 80)`, and feasible actions."""
        return self._belief.observe()

    def holds(self, text: str) -> bool:
        """Whether a condition such as `(and (lit hall) (>= (fuel rover) 20))` holds now, as it is believed.

        Raises PddlError if the text is not PDDL, and UnknownNameError if the domain does not have a name in it.
        """
        with lock_of(self._domain):
            asked = [one.expression for one in conditions(self._domain, text)]
        return goal_holds(self._domain, self.state, asked)

    def objects(self, type_name: str) -> tuple[str, ...]:
        """The objects of a type and of its subtypes, in the order of the files and then of their appearance."""
        return self._domain.objects_of(self._domain.spelling("type", type_name, type_name))

    def add_object(self, name: str, type_name: str) -> None:
        """Add an object that has appeared; call it between ticks. Raises UnknownNameError if it cannot be added."""
        self._use(with_object(self._domain, name, type_name))

    def remove_object(self, name: str) -> None:
        """Remove an object and stop the steps that use it, between ticks; UnknownNameError if it cannot be removed."""
        domain, name = (
            without_object(self._domain, name),
            self._domain.spelling("object", name, name),
        )
        self._release([one for one in self._running if name in one.step.arguments])
        self._use(domain)
        if self._plan is not None and any(
            name in step.arguments for step in self._plan.unfinished_steps
        ):
            self._want(Decision(f"{name} is gone", is_needed=True))

    def _use(self, domain: Domain) -> None:
        with lock_of(domain):
            self._domain = domain
            for part in (self._belief, self._effects, self.goals):
                part.use(domain)
            if self._client.is_under_way:
                self._replanning.want(Decision("the objects changed", is_needed=True))
        self._found_valid = self._expected = None

    @property
    def findings(self) -> tuple[str, ...]:
        """Likely mistakes in the domain, see `Domain.check`, and names that are sensed but not in the domain."""
        return (*self._findings, *self._belief.passed_over)

    @property
    def plans(self) -> tuple[PlanRecord, ...]:
        """The records of the last plannings that were answered: when, why and with what result; the oldest go first."""
        return self._replanning.records

    @property
    def current_steps(self) -> tuple[Step, ...]:
        """The steps that run, in the order in which they started."""
        return tuple(running.step for running in self._running)

    @property
    def waits_for_news(self) -> bool:
        """Whether the next tick does no more than tick the running steps, unless there is news, whatever the time."""
        is_going_on = self.status == Status.RUNNING and not self._replanning.is_busy
        is_planned = not self._replanning.had_no_plan and not self._setbacks.weights
        return (
            is_going_on
            and is_planned
            and self.goals.version == self._seen_goals
            and not self._monitor.is_forecast
        )

    def catch_up(self) -> None:
        """Wait for the planner's answer if it is due by now; for lock-step simulation, called before the tick.

        Raises PlanningBudgetError if the answer needs more wall-clock time than the planner allows.
        """
        self._client.catch_up()

    def wait_no_more(self) -> None:
        """End all pauses and forget all failures, so that the next tick may plan and may begin any step."""
        self._replanning.wait_no_more()

    def setup(self, **kwargs: object) -> None:
        """Let the planner start to prepare, and keep the arguments for the steps; called once before the first tick."""
        self._setup_arguments = kwargs
        if isinstance(self._planner, Planner):
            problem = Problem(self._domain, self._belief.observe())
            self._planner.prepare(problem, self._belief.sensed.facts)

    def initialise(self) -> None:
        """Forget the plan of the last round but keep the believed state; called on the first tick of a round."""
        self._drop_plan()

    def tick(self) -> Iterator[Behaviour]:
        """Tick, and also yield the ticked nodes of the steps, so that visitors see them."""
        for node in super().tick():
            yield from self._ticked
            yield node

    def update(self) -> Status:
        """Sense, run the steps and replan if necessary; called on each tick, never waits."""
        self._ticked = []
        if self._is_midway:  # an interrupt cut the previous tick, or `_drop_plan`, short
            unlock(self._domain)
            self._drop_plan()
        self._is_midway = True
        try:
            status = self._advance()
        except BaseException:
            unlock(self._domain)
            self._drop_plan()
            raise
        self._is_midway = False
        return status

    def terminate(self, new_status: Status) -> None:
        """Stop the running steps, and give up the plan and planning; called when the round ends or is interrupted."""
        self._drop_plan()

    def shutdown(self) -> None:
        """Stop as after an interrupt; called when the tree is shut down."""
        if self.status == Status.RUNNING:
            self.stop(Status.INVALID)
        self._drop_plan()
        if self._owns_planner and isinstance(self._planner, Planner):
            self._planner.close()

    def tip(self) -> Behaviour | None:
        """Return the node that ran last: the one of the first running step, if a step runs."""
        return self.children[0].tip() if self.children else super().tip()

    def _advance(self) -> Status:
        self._cause = self._feasibility.latest()
        for name, kind, is_there in tuple(self._belief.appeared()):
            self.add_object(name, kind) if is_there else self.remove_object(name)
        self._watch(self._belief.observe())
        self._tick_steps(tuple(self._running))
        self._take_plan()
        status = self._go_on()
        rounds = _MOST_ROUNDS
        while status == Status.RUNNING and self._client.was_answered_at_once and rounds:
            self._take_plan()
            status, rounds = self._go_on(), rounds - 1
        return status

    def _go_on(self) -> Status:
        while self._tick_steps(self._start_ready()):
            pass
        state = self._belief.observe()
        self._expected = (state, self._belief.numbers) if self._policy.eager else None
        return self._conclude(state)

    def _watch(self, state: State) -> None:
        """Stop the steps that cannot go on, and check whether the plan still works."""
        if self._effects.update():
            self._found_valid = None
        goals_changed, self._seen_goals = self.goals.version != self._seen_goals, self.goals.version
        if goals_changed:
            self._replanning.goals_changed(is_needed=self._plan is None)
            if self._plan is not None:
                self._plan = self._monitor.aimed(self._plan, state, self.goals)
        for running in tuple(self._running):
            missing = missing_meanwhile(self._domain, running.step, state)
            if missing is not None:
                self._release([running])
                reason = because(self._domain, running.step, missing, verb="became")
                cause = self._cause if self._domain.is_feasibility(missing) else None
                self._want(Decision(reason, is_needed=True, cause=cause))
        if self._plan is not None:
            flaw = self._flaw(self._plan, self._belief.observe())
            news = news_of(self._expected, (state, self._belief.numbers), self._replanning.matters)
            decision = decide(self._policy, flaw=flaw, goals_changed=goals_changed, news=news)
            self._want(
                decision
                if decision is None or goals_changed
                else replace(decision, cause=self._cause)
            )

    def _flaw(self, plan: PlanExecution, state: State) -> str | None:
        """Return in words why the rest of the plan no longer works; checked again only when something has changed."""
        now = (state, self._belief.numbers)
        if (
            self._found_valid is None
            or self._found_valid[0] is not plan
            or self._found_valid[1] != now
        ):
            if (
                self._replanning.had_no_plan
                and self._replanning.why_no_plan(self._unstarted(state)) is None
            ):
                return "the state changed"
            flaw = plan.prediction(self._effects.domain, state).flaw or self._monitor.overspent(
                plan
            )
            self._found_valid = (plan, now) if flaw is None else None
            if flaw is not None:
                return flaw
        return self._monitor.too_late(plan, state, self._shares_left())

    def _want(self, decision: Decision | None) -> None:
        """Note that a plan is wanted; if it is needed, drop the current plan."""
        if decision is None:
            return
        self._replanning.want(decision)
        if decision.is_needed:
            self._plan = None
            if self._policy.while_planning == "hold":
                self._release(self._running)

    def _conclude(self, state: State) -> Status:
        """Return the status of the tick, and ask the planner for a plan if one is wanted."""
        if not self._running and self._monitor.is_over(state, self.goals, self._plan):
            self._drop_plan()
            self.feedback_message = "the goal holds"
            return Status.SUCCESS
        planned_from = self._unstarted(state)
        if not self._replanning.is_busy and (self._plan is None or self._plan.is_finished):
            why = self._replanning.why_no_plan(planned_from)
            if why is not None:
                self._drop_plan()
                self.feedback_message = why
                return Status.FAILURE
            changed = Decision("the state changed", is_needed=True, cause=self._cause)
            self._want(
                changed if self._replanning.had_no_plan else Decision("start", is_needed=True)
            )
        asked = self._replanning.ask_if_allowed(planned_from, self._shares_left())
        if asked is not None:
            self._ended_meanwhile.clear()
            self.feedback_message = asked
        elif not self._replanning.is_busy:
            waiting = [] if self._running or self._plan is None else self._plan.startable
            steps = (
                [self._plan.steps[number] for number in waiting] if self._plan is not None else []
            )
            doing = [str(step) for step in self.current_steps]
            doing += [
                f"{step} again in {self._setbacks.wait_s(step):.2g} s, as it failed"
                for step in steps
            ]
            self.feedback_message = ", ".join(doing)
        return Status.RUNNING

    def _unstarted(self, state: State) -> State:
        """Return the state to plan from: without the running steps, so that the plan may start with these."""
        return self._belief.unstarted(self._running, state)

    def _take_plan(self) -> None:
        if not self._client.has_answer:
            return
        found = self._replanning.take(self._unstarted(self._belief.observe()))
        if found is None:
            return
        plan, decision = self._with_what_ended(found[0]), found[1]
        kept: dict[int, RunningStep] = {}
        for running in self._running:
            number = plan.starts_with(running.step)
            if number is not None:
                kept[number] = running
                plan = plan.with_event(StepEvent(number, False))
        others = [running for running in self._running if running not in kept.values()]
        state = self._belief.observe()
        after = self._belief.unstarted(others, state)
        old = None if decision.is_needed else self._plan
        self._switches = 0 if old is None else self._switches
        if old is not None:
            margin, weights = self._policy.hysteresis * (1 + self._switches), self._setbacks.weights
            both = (plan, after), (old, state)
            if not self._monitor.is_better(*both, self.goals, self._shares_left(), weights, margin):
                return
            self._switches += 1
        self._release(others)
        for number, running in kept.items():
            running.number = number
        self._plan = plan

    def _with_what_ended(self, plan: PlanExecution) -> PlanExecution:
        """Return the plan with those of its first steps marked as done that succeeded while it was made."""
        for step in self._ended_meanwhile:
            number = plan.starts_with(step)
            if number is not None:
                plan = plan.with_event(StepEvent(number, False), StepEvent(number, True))
        return plan

    def _start_ready(self) -> tuple[RunningStep, ...]:
        begun: list[RunningStep] = []
        while self._plan is not None and self._plan.startable:
            state = self._belief.observe()
            if self._monitor.is_over(state, self.goals, self._plan):
                break
            flaw = self._flaw(self._plan, state)
            if flaw is not None:
                self._want(Decision(flaw, is_needed=True))
                break
            rested = [
                one
                for one in self._plan.startable
                if not self._setbacks.wait_s(self._plan.steps[one])
            ]
            if not rested:
                break
            begun.append(self._begin(self._plan, rested[0], state))
        return tuple(begun)

    def _begin(self, plan: PlanExecution, number: int, state: State) -> RunningStep:
        step = plan.steps[number]
        running = RunningStep(step, number, self._clock())
        self._running.append(running)
        running.begin(self._factories[step.schema], self, self._setup_arguments)
        self._belief.start(running, step, state)
        self._show_children()
        self._plan = plan.with_event(StepEvent(number, False))
        return running

    def _tick_steps(self, steps: tuple[RunningStep, ...]) -> bool:
        """Tick steps; return whether one has succeeded, so that others may start."""
        any_ended = False
        for running in steps:
            if running not in self._running:
                continue
            status, text, ticked = running.tick()
            self._ticked += ticked
            if status == Status.RUNNING:
                continue
            failure = ": ".join(filter(None, [f"{running.step} failed", text]))
            wrong = self._ended(running) if status == Status.SUCCESS else failure
            if wrong is not None:
                self._release([running])
                self._setbacks.add(running.step)
                self._want(Decision(wrong, is_needed=True))
            any_ended |= wrong is None
        return any_ended

    def _ended(self, running: RunningStep) -> str | None:
        """Believe the effects of a step that succeeded, or return why it cannot have succeeded."""
        step, state = running.step, self._belief.observe()
        missing = missing_at_end(self._domain, step, state)
        if missing is not None:
            return f"{step} ended although {missing} does not hold"
        self._belief.end(running, step, state)
        self._took_s[step.schema] = self._clock() - running.began_s
        self._setbacks.forget(step)
        self._release([running])
        if self._plan is not None:
            self._plan = self._plan.with_event(StepEvent(running.number, True))
        if self._client.is_under_way:
            self._ended_meanwhile.append(step)
        unmet = self._effects.ended(step, state)
        if unmet and self._plan is not None:
            self._rely_no_more(self._plan, unmet)
        return None

    def _rely_no_more(self, plan: PlanExecution, unmet: Iterable[UnmetEffect]) -> None:
        """Replan if the rest of the plan needs an action that a step did not make feasible as expected."""
        domain, state = self._effects.domain, self._belief.observe()
        expected = state | {self._domain.feasible_atom(one.action) for one in unmet}
        if (
            plan.prediction(domain, state).flaw is not None
            and plan.prediction(domain, expected).flaw is None
        ):
            self._want(Decision("; ".join(map(str, unmet)), is_needed=True))

    def _release(self, steps: Iterable[RunningStep]) -> None:
        """Stop steps that still run, take back the effects believed since their start, and release them."""
        for running in tuple(steps):
            running.release()
            self._belief.give_up(running, running.step)
            self._running.remove(running)
            self._show_children()

    def _show_children(self) -> None:
        self.children = [
            running.behaviour for running in self._running if running.behaviour is not None
        ]

    def _shares_left(self) -> Mapping[Step, float]:
        """Return which share of each running step is left, by how long such a step last took or is declared."""
        now_s, shares = self._clock(), dict[Step, float]()
        for running in self._running:
            whole_s = self._took_s.get(
                running.step.schema, self._domain.duration_s(running.step.schema)
            )
            shares[running.step] = (
                max(1.0 - (now_s - running.began_s) / whole_s, 0.0) if whole_s else 1.0
            )
        return shares

    def _drop_plan(self) -> None:
        self._is_midway = True
        self._plan = self._found_valid = self._expected = None
        self._replanning.forget()
        self._release(self._running)
        self.children = []
        self._is_midway = False
