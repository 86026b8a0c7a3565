"""Executes plans with py_trees behaviours, and replans when the world or the goals change.

A tick senses, updates the belief, monitors the steps and the plan, ticks the steps, takes the
planner's answer, starts steps and decides whether to ask for a plan: see `PlanExecutor._advance`.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping
from inspect import signature
from typing import Any

from py_trees.behaviour import Behaviour
from py_trees.common import Status

from rosa_pddl.belief import (
    Belief,
    ExpectedEffects,
    FeasibilityEvents,
    LastingFeasibility,
    Sense,
)
from rosa_pddl.domain import (
    Domain,
    Feasibility,
    MissingBehaviourError,
    SensingError,
    State,
    Step,
    UnknownNameError,
    UnsupportedPddlError,
    nearest,
    with_object,
    without_object,
)
from rosa_pddl.grounding import binding_of
from rosa_pddl.plan_monitor import PlanExecution, PlanMonitor
from rosa_pddl.planner import Planner
from rosa_pddl.reader import conditions
from rosa_pddl.replanning import (
    Goals,
    PlannerClient,
    PlanRecord,
    PlansAhead,
    Replanning,
    ReplanningPolicy,
)
from rosa_pddl.validate import (
    StepEvent,
    because,
    changes,
    goal_holds,
    missing_meanwhile,
    missing_of,
    takes_s,
)

Factory = Callable[[Step], Behaviour]


class RunningStep:
    """A running step, with its number in the plan that is executed.

    The executor lists it before `begin` makes its behaviour, so that the executor can release it
    after an interrupt at any instant. If an interrupt stops `release` itself, it may be called
    again.
    """

    def __init__(self, step: Step, number: int, began_s: float) -> None:
        self.step = step
        self.number = number
        self.began_s = began_s
        self.behaviour: Behaviour | None = None
        self._is_ticking = False
        self._nodes_set_up: list[Behaviour] = []

    def begin(
        self, factory: Factory, parent: "PlanExecutor", arguments: Mapping[str, object]
    ) -> None:
        """Make the behaviour and set it up; an error gets a note that names the step."""
        try:
            behaviour = factory(self.step)
            if not isinstance(behaviour, Behaviour):
                message = f"for {self.step} what is given for {self.step.schema!r} made"
                raise MissingBehaviourError(
                    f"{message} {behaviour!r}, expected a py_trees behaviour"
                )
            self.behaviour = behaviour
            behaviour.parent = parent
            for node in behaviour.iterate():
                parent.adopt(node)
                self._nodes_set_up.append(node)
                node.setup(**arguments)
        except Exception as error:
            error.add_note(f"it was raised when the behaviour of {self.step} was made")
            raise

    def tick(self) -> tuple[Status, str, list[Behaviour]]:
        """Tick the behaviour; return its status, its feedback message and the ticked nodes.

        An exception in the behaviour of a step fails the step, never the tree.
        """
        assert self.behaviour is not None
        ticked: list[Behaviour] = []
        self._is_ticking = True
        try:
            ticked.extend(self.behaviour.tick())
        except Exception as error:
            self._stop(self.behaviour)
            return Status.FAILURE, f"{type(error).__name__}: {error}", ticked
        self._is_ticking = False
        return self.behaviour.status, self.behaviour.feedback_message, ticked

    def release(self) -> None:
        """Stop the behaviour if it runs, and shut its nodes down."""
        if self.behaviour is not None:
            if self._is_ticking or self.behaviour.status == Status.RUNNING:
                self._stop(self.behaviour)
            self.behaviour.parent = None
        while self._nodes_set_up:
            node = self._nodes_set_up[-1]
            try:
                node.shutdown()
            except Exception as error:  # the other nodes must be released all the same
                node.logger.error(f"{type(error).__name__} in shutdown of {self.step}: {error}")
            self._nodes_set_up.pop()

    def _stop(self, behaviour: Behaviour) -> None:
        # if an interrupt cut a tick short, nodes below may have begun work and not be RUNNING yet
        was_midway = self._is_ticking
        self._is_ticking = True
        for node in behaviour.iterate() if was_midway else (behaviour,):
            try:
                node.stop(Status.INVALID)
            except Exception as error:  # the executor must go on all the same
                node.logger.error(f"{type(error).__name__} in terminate of {self.step}: {error}")
                node.status = Status.INVALID
        self._is_ticking = False


def check_behaviours(domain: Domain, behaviours: Mapping[str, Factory]) -> None:
    """Check that each PDDL action has its behaviour, and each behaviour its PDDL action.

    Raises:
        MissingBehaviourError, UnknownNameError: one of them is missing, or is no factory.
    """
    for schema in domain.schemas:
        if schema not in behaviours:
            message = f"no behaviour for the PDDL action {schema!r} of {domain.file}"
            raise MissingBehaviourError(f"{message}; {nearest(schema, behaviours)}")
        if not callable(behaviours[schema]):
            message = f"no behaviour can be made for {schema!r} from {behaviours[schema]!r}"
            advice = "expected what makes one for each step, such as a lambda"
            raise MissingBehaviourError(f"{message}; {advice}")
    for name in behaviours:
        if name not in domain.schemas:
            message = (
                f"a behaviour is given for {name!r}, but {domain.file} has no such PDDL action"
            )
            raise UnknownNameError(f"{message}; {nearest(name, domain.schemas)}")


class PlanExecutor(Behaviour):
    """Plans for the goals and executes the plan: step by step, or as a temporal plan says.

    It is RUNNING while it plans and while steps run, SUCCESS when the goals hold, and FAILURE when
    there is no plan. After a FAILURE, the next tick plans again only if something has changed.
    docs/pddl.md says when it replans and what it believes.

    Args:
        name: name of the behaviour.
        kb: says which ROSA actions are feasible.
        domain: what `load_domain` returned.
        behaviours: for each PDDL action, a factory that makes the behaviour of a step.
        sense: returns what is sensed now: whether facts such as `(lit room)` hold, and the values
            of numeric facts, such as `{"(length a b)": 3.5}`. Called several times a tick.
        clock: returns the time [s].
        planner: plans in the background; by default `Planner()`.
        delay_s: the executor takes the planner's answer this long after the request [s], however
            long planning took, so that every run of a simulation is the same; None to take it as
            soon as it is there.
        policy: how often to replan, and how patient to be.

    Attributes:
        goals: the goals to reach; may be changed between ticks.
        adopt: called with each behaviour that was made for a step, before its setup; a
            `rosa_bt.TreeRunner` sets it, so that steps follow its clock and their errors are told.

    Raises:
        PddlError: the knowledge base does not know a ROSA action of the domain.
        MissingBehaviourError: a PDDL action has no behaviour factory, or one that is no function.
        UnknownNameError: a behaviour is given for a PDDL action that the domain does not have.
        SensingError: `sense` is no function.
        UnsupportedPddlError: the files can be planned for but not executed.
    """

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
    ) -> None:
        super().__init__(name)
        if domain.only_planned:
            message = f"it can be planned for, but not executed: {domain.only_planned}"
            raise UnsupportedPddlError(message, domain.file)
        if not callable(sense):
            message = f"sense is {sense!r}, expected a function that returns what is sensed"
            raise SensingError(f"{message}, such as lambda: {{'(lit room)': True}}")
        self._findings = domain.check(kb)
        check_behaviours(domain, behaviours)
        for schema, factory in behaviours.items():
            try:
                signature(factory).bind("step")
            except TypeError:
                message = f"what makes {schema!r} takes {signature(factory)}"
                raise MissingBehaviourError(f"{message}, expected one argument: the step") from None
        self.goals = Goals(domain)
        self._domain = domain
        self._factories = dict(behaviours)
        self._policy = policy or ReplanningPolicy()
        self._planner: PlansAhead = planner or Planner()
        self._owns_planner = planner is None
        self._belief = Belief(domain, kb, sense)
        self._numbers = self._belief.numbers
        self._effects = ExpectedEffects(domain, kb)
        self._feasibility = FeasibilityEvents(kb)
        forecasts = kb.forecasts if isinstance(kb, LastingFeasibility) else dict
        self._monitor = PlanMonitor(self._effects, self._belief, forecasts)
        self._client = PlannerClient(self._planner, clock, delay_s)
        self._replanning = Replanning(self.goals, self._monitor, self._client, self._policy)
        self._backoff = self._replanning.backoff
        self._setup_arguments: dict[str, object] = {}
        self.adopt: Callable[[Behaviour], object] = lambda _: None
        self._running: list[RunningStep] = []
        self._ended_meanwhile: list[Step] = []
        self._missing_effects: dict[Step, tuple[State, int]] = {}  # atoms, how many times
        self._plan: PlanExecution | None = None
        self._checked: tuple[object, ...] = ()  # for what a plan was found to be valid last
        self._seen_goals = self.goals.version
        self._ticked: list[Behaviour] = []
        self._cause: int | None = None
        self._clock = clock
        self._is_midway = False
        self._kb: Any = kb
        self._keeps_required = self._policy.keep_required and hasattr(kb, "request_action")
        self._succeeded: str | None = None
        self._kept: tuple[str, float] | None = None

    # ------------------------------------------------------------ what users ask

    @property
    def state(self) -> State:
        """The state as it is believed now: facts, numbers, and feasible actions."""
        return self._belief.observe()

    def holds(self, text: str) -> bool:
        """Whether a condition such as `(and (lit hall) (>= (fuel rover) 20))` is believed to hold.

        Raises PddlError if the text is not PDDL, UnknownNameError for a name that there is not.
        """
        goals = [goal.expression for goal in conditions(self._domain, text)]
        return goal_holds(self._domain, self.state, goals)

    def objects(self, type_name: str) -> tuple[str, ...]:
        """The objects of a type and of its subtypes, in the order of files and appearance."""
        return self._domain.objects_of(self._domain.spelling("type", type_name))

    def add_object(self, name: str, type_name: str) -> None:
        """Add an object that has appeared; call it between ticks.

        Raises as `with_object`, and PddlError for a ROSA action that the knowledge base lacks.
        """
        domain = with_object(self._domain, name, type_name)
        self._findings = domain.check(self._kb)
        self._use(domain)

    def remove_object(self, name: str) -> None:
        """Remove an object, its goals, and the steps that use it; call it between ticks.

        Raises UnknownNameError if it cannot be removed.
        """
        spelled = self._domain.spelling("object", name)
        domain = without_object(self._domain, name)
        self._release([each for each in self._running if spelled in each.step.arguments])
        self._use(domain)
        steps = () if self._plan is None else self._plan.steps
        if any(spelled in step.arguments for step in steps):
            self._request_plan(f"{spelled} is gone")

    def _use(self, domain: Domain) -> None:
        self._domain = domain
        self._belief.use(domain)
        self._effects.use(domain)
        self.goals.use(domain)
        self._missing_effects.clear()
        if self._client.is_under_way:
            self._request_plan("the objects changed")

    @property
    def findings(self) -> tuple[str, ...]:
        """Likely mistakes in the domain, and names that are sensed but not in the domain."""
        return (*self._findings, *self._belief.ignored_percepts)

    @property
    def plans(self) -> tuple[PlanRecord, ...]:
        """The records of the last plannings that were answered; the oldest go first."""
        return self._replanning.records

    @property
    def left_out(self) -> tuple[str, ...]:
        """The goals that are left out for now, as they cannot be reached."""
        return tuple(goal.text for goal in self._replanning.left_out)

    @property
    def current_steps(self) -> tuple[Step, ...]:
        """The steps that run, in the order in which they started."""
        return tuple(running.step for running in self._running)

    # ------------------------------------------------------------ what py_trees calls

    def catch_up(self) -> None:
        """Wait for the planner's answer if it is due by now; called before a tick in lock-step.

        Raises PlanningBudgetError if the answer needs more wall-clock time than the planner allows.
        """
        self._client.catch_up()

    def setup(self, **kwargs: object) -> None:
        """Keep what the behaviours of steps are to be set up with; called before the first tick."""
        self._setup_arguments = kwargs

    def initialise(self) -> None:
        """Forget the plan of the last round but keep the believed state; called on a new round."""
        self._drop_plan()
        self._replanning.left_out = ()

    def tick(self) -> Iterator[Behaviour]:
        """Tick, and also yield the ticked nodes of the steps, so that visitors see them."""
        for node in super().tick():
            yield from self._ticked
            yield node

    def update(self) -> Status:
        """Sense, run the steps and replan if necessary; called on each tick, never waits."""
        self._ticked = []
        if self._is_midway:
            # an interrupt cut the last tick short: what it had seen may not have been acted on
            self._drop_plan()
            self._replanning.forget_failures()
        self._is_midway = True
        try:
            status = self._advance()
        except BaseException:
            self._drop_plan()
            self._replanning.forget_failures()
            raise
        self._is_midway = False
        return status

    def terminate(self, new_status: Status) -> None:
        """Stop the running steps, and give up plan and planning; called when the round ends."""
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

    # ------------------------------------------------------------ the five stages of a tick

    def _advance(self) -> Status:
        self._sense()
        state = self._belief.observe()
        self._monitor_steps(state)
        self._monitor_plan(state)
        self._tick_steps(tuple(self._running))
        self._take_answer()
        while self._tick_steps(self._start_ready()):
            pass
        status = self._decide(self._belief.observe())
        self._keep_required(status)
        return status

    def _keep_required(self, status: Status) -> None:
        """Keep the action of a step that has just succeeded required until the next one starts."""
        action = self._succeeded if self._keeps_required else None
        self._succeeded = None
        is_late = self._kept is not None and self._clock() >= self._kept[1]
        if self._running or status != Status.RUNNING or is_late:
            self._let_go()
        # if it is required by now, another behaviour requires it
        elif action is not None and not self._kb.actions[action].is_required:
            self._kept = action, self._clock() + self._planner.timeout_s
            self._kb.request_action(action)

    def _let_go(self) -> None:
        """Require the kept action no longer."""
        if self._kept is not None:
            self._kb.cancel_action(self._kept[0], "completed")
        self._kept = None

    def _sense(self) -> None:
        """Find out which event changed feasibility, and which objects came and went."""
        self._cause = self._feasibility.latest(self._domain)
        for name, kind, is_there in tuple(self._belief.appeared()):
            if is_there:
                self.add_object(name, kind)
            else:
                self.remove_object(name)
        if self._belief.numbers is not self._numbers:
            domain = self._domain.with_numbers(self._belief.numbers)
            if domain is not self._domain:  # numbers on which plans depend have changed
                self._domain = self._belief.domain = domain
                self._effects.use(domain)
            self._numbers = self._belief.numbers

    def _monitor_steps(self, state: State) -> None:
        """Stop the steps that cannot go on, or that take far too long."""
        self._effects.update()
        for step, (missing, _) in tuple(self._missing_effects.items()):
            if missing <= state:  # what a step should bring about is seen after all
                self._backoff.forget(step)
                del self._missing_effects[step]
        for running in tuple(self._running):
            missing_condition = missing_meanwhile(self._domain, running.step, state)
            if missing_condition is not None:
                self._release([running])
                reason = because(self._domain, running.step, missing_condition, verb="became")
                is_unfeasible = self._domain.is_feasibility(missing_condition)
                self._request_plan(reason, self._cause if is_unfeasible else None)
                continue
            limit_s = self._expected_s(running.step) * self._policy.overrun
            passed_s = self._clock() - running.began_s
            if limit_s and passed_s > limit_s:
                self._fail(running, f"{running.step} takes longer than {limit_s:.3g} s")

    def _monitor_plan(self, state: State) -> None:
        """Check whether the plan still works."""
        goals_changed = self.goals.version != self._seen_goals
        self._seen_goals = self.goals.version
        flaw = None
        if self._plan is not None:
            if goals_changed:
                hard = self._replanning.hard
                soft = self.goals.soft
                self._plan = self._monitor.aimed(self._plan, state, hard, soft)
            flaw = self._flaw(self._plan, self._belief.observe())
        if goals_changed:
            self._replanning.forget_failures()
            if self._plan is not None or self._client.is_under_way:
                self._request_plan(f"the goals changed: {flaw}" if flaw else "the goals changed")
        elif flaw is not None:
            self._request_plan(flaw, self._cause)

    def _decide(self, state: State) -> Status:
        """Return the status of the tick, and ask the planner for a plan if one is wanted."""
        replanning = self._replanning
        if not self._running and self._is_over(state):
            if not replanning.left_out:
                self._drop_plan()
                self.feedback_message = self.goals.told("the goal holds")
                return Status.SUCCESS
            if not replanning.is_busy:
                self._plan = None
                replanning.try_left_out()
        planned_from = self._belief.unstarted(self._running, state)
        if not replanning.is_busy and (self._plan is None or self._plan.is_finished):
            why = replanning.why_no_plan(planned_from)
            if why is not None:
                self._drop_plan()
                self.feedback_message = why
                return Status.FAILURE
            if replanning.had_no_plan:
                self._request_plan("the state changed", self._cause)
            else:
                self._request_plan("start")
        asked = replanning.ask_if_allowed(planned_from, self._shares_left())
        if asked is not None:
            self._ended_meanwhile.clear()
            self.feedback_message = asked
        elif not replanning.is_busy:
            self.feedback_message = ", ".join(self._activities())
        return Status.RUNNING

    def _is_over(self, state: State) -> bool:
        """Whether all goals hold, or the plan is finished and gave up only soft goals."""
        wanted = self._replanning.hard
        if self._plan is None or not self._plan.is_finished:
            wanted += self.goals.soft
        return self._monitor.holding(wanted, state) == wanted

    def _activities(self) -> Iterator[str]:
        yield from map(str, self.current_steps)
        if not self._running and self._plan is not None:
            for number in self._plan.startable:
                step = self._plan.steps[number]
                yield f"{step} again in {self._backoff.wait_s(step):.2g} s, as it failed"

    # ------------------------------------------------------------ plans

    def _flaw(self, plan: PlanExecution, state: State) -> str | None:
        """Return in words why the rest of the plan no longer works; checked if news is there."""
        domain = self._effects.domain
        now = plan, domain, state, self._belief.numbers
        if self._checked != now:
            flaw = plan.prediction(domain, state).flaw
            if flaw is not None:
                return flaw
            self._checked = now
        return self._monitor.too_late(plan, state, self._shares_left())

    def _request_plan(self, reason: str, cause: int | None = None) -> None:
        """Note that a plan is wanted, and drop the current plan; running steps go on."""
        self._replanning.want(reason, cause)
        self._plan = None

    def _take_answer(self) -> None:
        """Take the planner's answer, if it is due; keep the running steps that it starts with."""
        if not self._client.has_answer:
            return
        state = self._belief.observe()
        plan = self._replanning.take(self._belief.unstarted(self._running, state))
        if plan is None:
            return
        for step in self._ended_meanwhile:
            number = plan.starts_with(step)
            if number is not None:
                plan = plan.with_event(StepEvent(number, False), StepEvent(number, True))
        others = list[RunningStep]()
        for running in self._running:
            number = plan.starts_with(running.step)
            if number is None:
                others.append(running)
            else:
                running.number = number
                plan = plan.with_event(StepEvent(number, False))
        self._release(others)
        self._plan = plan

    def _drop_plan(self) -> None:
        self._is_midway = True
        self._plan = None
        self._replanning.forget()
        self._release(self._running)
        self._let_go()
        self.children = []
        self._is_midway = False

    # ------------------------------------------------------------ steps

    def _start_ready(self) -> tuple[RunningStep, ...]:
        begun: list[RunningStep] = []
        while self._plan is not None and self._plan.startable:
            state = self._belief.observe()
            if self._is_over(state):
                break
            flaw = self._flaw(self._plan, state)
            if flaw is not None:
                self._request_plan(flaw)
                break
            steps = self._plan.steps
            rested = [n for n in self._plan.startable if not self._backoff.wait_s(steps[n])]
            if not rested:
                break
            begun.append(self._begin(self._plan, rested[0], state))
        return tuple(begun)

    def _begin(self, plan: PlanExecution, number: int, state: State) -> RunningStep:
        step = plan.steps[number]
        running = RunningStep(step, number, self._clock())
        self._running.append(running)
        if self._kept is not None and self._kept[0] == step.action:
            self._let_go()  # the step requires it itself
        running.begin(self._factories[step.schema], self, self._setup_arguments)
        self._belief.start(running, step, state)
        self._show_children()
        self._plan = plan.with_event(StepEvent(number, False))
        return running

    def _tick_steps(self, steps: tuple[RunningStep, ...]) -> bool:
        """Tick steps; return whether one has succeeded, so that others may start."""
        any_succeeded = False
        for running in steps:
            if running not in self._running:
                continue
            status, text, ticked = running.tick()
            self._ticked += ticked
            if status == Status.SUCCESS:
                wrong = self._end(running)
                any_succeeded |= wrong is None
                if wrong is not None:
                    self._fail(running, wrong)
            elif status != Status.RUNNING:
                self._fail(running, ": ".join(filter(None, [f"{running.step} failed", text])))
        return any_succeeded

    def _fail(self, running: RunningStep, reason: str) -> None:
        """Release a step that failed, and count the failure."""
        self._release([running])
        self._backoff.add(running.step)
        self._request_plan(reason)

    def _end(self, running: RunningStep) -> str | None:
        """Believe what a step brought about; return why it cannot have succeeded, or None."""
        step = running.step
        state = self._belief.observe()
        missing = missing_of(self._domain, self._domain.schema_of[step.schema].end, step, state)
        if missing is not None:
            return f"{step} ended although {missing} does not hold"
        self._belief.end(running, step, state)
        self._succeeded = step.action
        self._release([running])
        if self._plan is not None:
            self._plan = self._plan.with_event(StepEvent(running.number, True))
        if self._client.is_under_way:
            self._ended_meanwhile.append(step)
        self._look_for_effects(step, state)
        unmet = self._effects.ended(step, state)
        if unmet and self._plan is not None:
            domain = self._effects.domain
            state = self._belief.observe()
            expected = state.union(self._domain.feasible_atom(each.action) for each in unmet)
            is_flawed = self._plan.prediction(domain, state).flaw is not None
            if is_flawed and self._plan.prediction(domain, expected).flaw is None:
                self._request_plan("; ".join(map(str, unmet)))
        return None

    def _look_for_effects(self, step: Step, before: State) -> None:
        """Leave out a step whose effect is not seen, too many times in a row, as if it failed."""
        schema = self._domain.schema_of[step.schema]
        binding = binding_of(self._domain, step)
        _, added = changes(self._domain, schema.end_effects, binding, before)
        atoms = {atom for atom in added if atom in self._belief.sensed.facts}
        missing = atoms - self._belief.observe()
        if not missing:
            self._backoff.forget(step)
            self._missing_effects.pop(step, None)
            return
        count = self._missing_effects.get(step, (missing, 0))[1] + 1
        self._missing_effects[step] = frozenset(missing), count
        if count > self._policy.retries:
            self._backoff.add(step, count)
            self._request_plan(f"{step} did not bring {min(missing)} about {count} times")

    def _release(self, steps: Iterable[RunningStep]) -> None:
        """Stop steps that still run, take back what their starts made believed, release them."""
        for running in tuple(steps):
            running.release()
            self._belief.give_up(running)
            self._running.remove(running)
            self._show_children()

    def _show_children(self) -> None:
        behaviours = [running.behaviour for running in self._running]
        self.children = [behaviour for behaviour in behaviours if behaviour is not None]

    def _expected_s(self, step: Step) -> float:
        """Return how long a step is expected to take [s]: as declared for its arguments."""
        return takes_s(self._domain, step, self._belief.observe(), self._belief.numbers)

    def _shares_left(self) -> Mapping[Step, float]:
        """Return which share of each running step is left."""
        shares = dict[Step, float]()
        for running in self._running:
            whole_s = self._expected_s(running.step)
            passed_s = self._clock() - running.began_s
            shares[running.step] = max(1.0 - passed_s / whole_s, 0.0) if whole_s else 1.0
        return shares
