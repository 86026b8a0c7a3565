"""Executes plans with py_trees behaviours, and plans anew when the world or the goals are not what the plan needs."""

from collections.abc import Callable, Iterable, Iterator, Mapping

from py_trees.behaviour import Behaviour
from py_trees.common import Status

from rosa_pddl.domain import Domain, Feasibility, State, Step
from rosa_pddl.execution.asking import PlansAhead
from rosa_pddl.execution.belief import Belief, Sense, Undo, without
from rosa_pddl.execution.course import Course, Event
from rosa_pddl.execution.goals import Goals
from rosa_pddl.execution.hopes import Disappointment, Hopes
from rosa_pddl.execution.policy import Decision, ReplanningPolicy, Situation, decide, news_of
from rosa_pddl.execution.quest import Quest
from rosa_pddl.execution.replanning import PlanRecord, Replanning
from rosa_pddl.execution.running import Factory, Interlude, RunningStep, check_factories
from rosa_pddl.planning import Planner
from rosa_pddl.problem import Problem
from rosa_pddl.validate import because, missing_at_end, missing_meanwhile

__all__ = ["PlanExecutor"]


class PlanExecutor(Behaviour):
    """Plans towards the goals and executes the plan: one step at a time, or as a temporal plan's causal order allows.

    It is RUNNING while it plans and while steps run, SUCCESS when the goals hold, and FAILURE when there is no plan;
    ticked again after that it plans anew only if something has changed.

    It plans anew when a running step needs what does not hold any more, when a step fails, when the rest of the plan
    does not lead to the goals any more, when the goals change, and, if the policy says so, when something better may be
    possible. Feasibility is always the knowledge base's: the effects of a finished step are believed until sensed
    otherwise, those on `action_feasible` never. A step that did not bring such an effect about is not relied upon for
    it again as long as what was in the way still is.

    Args:
        name: of the behaviour.
        kb: says which ROSA actions are feasible.
        domain: what `load_domain` returned.
        behaviours: for each PDDL action, what makes the behaviour of a step.
        sense: returns what is sensed now: whether facts such as `(lit room)` hold, and the values of numeric facts that
            costs are made of, such as `{"(length a b)": 3.5}`; others stay as they were. Called several times a tick.
        clock: returns the time [s].
        planner: plans beside the ticks; by default Fast Downward.
        delay_s: the answer of the planner is taken this long after the request, whatever it took, so that a simulation
            is the same each time [s]; None to take it as soon as it is there.
        policy: when to plan anew, and what becomes of running steps meanwhile.
        meanwhile: makes of a step that was given up or has ended what is done until the next one has begun, if a plan
            has to be made for that; by default nothing is.

    Attributes:
        goals: what is to be reached; may be changed between ticks.
        findings: what may be an oversight in the domain, in sentences; see `Domain.check`.

    Raises:
        PddlError: the knowledge base does not know a ROSA action of the domain.
        MissingBehaviourError: a PDDL action has no behaviour, or something that makes none.
        UnknownNameError: a behaviour is given for a PDDL action that there is not.
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
        meanwhile: Factory | None = None,
    ) -> None:
        super().__init__(name)
        self.findings = domain.check(kb)
        check_factories(domain, behaviours)
        self.goals = Goals(domain)
        self._domain, self._factories = domain, dict(behaviours)
        self._policy = policy or ReplanningPolicy()
        self._owns_planner = planner is None
        self._planner: PlansAhead = Planner() if planner is None else planner
        self._belief = Belief(domain, kb, sense)
        self._hopes = Hopes(domain, kb)
        self._quest = Quest(self._hopes, lambda: self._belief.numbers)
        self._replanning = Replanning(self.goals, self._quest, self._planner, clock, delay_s, self._policy)
        self._setup_arguments: dict[str, object] = {}
        self._running: list[RunningStep] = []
        self._interlude = Interlude(meanwhile, self)
        self._ended_meanwhile: list[Step] = []
        self._course: Course | None = None
        self._found_valid: tuple[Course, Situation] | None = None
        self._seen_goals = self.goals.version
        self._expected: Situation | None = None
        self._ticked: list[Behaviour] = []

    @property
    def plans(self) -> tuple[PlanRecord, ...]:
        """Every planning that was answered: when, why, with what result. One that was interrupted has no result."""
        return tuple(self._replanning.records)

    @property
    def current_step(self) -> Step | None:
        """The step that runs; of several the one that started first."""
        return self._running[0].step if self._running else None

    @property
    def current_steps(self) -> tuple[Step, ...]:
        """The steps that run, in the order in which they started."""
        return tuple(running.step for running in self._running)

    @property
    def remaining_steps(self) -> tuple[Step, ...]:
        """The steps of the plan that have not started."""
        course = self._course
        return () if course is None else tuple(course.steps[number] for number in course.remaining)

    def catch_up(self) -> None:
        """Wait for an answer of the planner that is due by now.

        Call it in lock-step simulation, when the clock has moved on and before the tick: then a tick never waits and
        yet finds each answer that is due.

        Raises:
            PlanningBudgetError: the answer needed more wall-clock time than the planner allows, so that going on would
                make the run depend on the machine.
        """
        self._replanning.catch_up()

    # ---------------------------------------------------------------- hooks of py_trees

    def setup(self, **kwargs: object) -> None:
        """Let the planner prepare, and keep the arguments for the steps; called once before the first tick."""
        self._setup_arguments = kwargs
        if isinstance(self._planner, Planner):
            problem = Problem(self._domain, self._belief.observe())
            self._planner.prepare(problem, self._belief.sensed_atoms)

    def initialise(self) -> None:
        """Forget the plan of the last round, keep what is believed; called on the first tick of a round."""
        self._drop_plan()

    def tick(self) -> Iterator[Behaviour]:
        """Tick, and show visitors the nodes of the running steps too."""
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
        """Stop the running steps and forget the planning; called when the round ends or is interrupted."""
        self._drop_plan()

    def shutdown(self) -> None:
        """Stop as if interrupted; called when the tree is shut down."""
        if self.status == Status.RUNNING:
            self.stop(Status.INVALID)
        self._drop_plan()
        if self._owns_planner and isinstance(self._planner, Planner):
            self._planner.close()

    def tip(self) -> Behaviour | None:
        """Return the node that ran last: that of the first step, if one runs."""
        return self.children[0].tip() if self.children else super().tip()

    # ---------------------------------------------------------------- one tick

    def _advance(self) -> Status:
        self._watch(self._belief.observe())
        self._tick_steps(tuple(self._running))
        self._take_plan()
        while self._tick_steps(self._start_ready()):
            pass
        state = self._belief.observe()
        self._expected = (state, self._belief.numbers)
        return self._conclude(state)

    def _watch(self, state: State) -> None:
        """Stop what cannot go on, and find out whether the plan still does."""
        if self._hopes.look() and self._course is not None:
            self._course = self._course.with_domain(self._hopes.domain)
        goals_changed, self._seen_goals = self.goals.version != self._seen_goals, self.goals.version
        if goals_changed:
            self._replanning.goals_changed(is_needed=self._course is None)
            if self._course is not None:
                self._course = self._quest.aimed(self._course, state, self.goals)
        for running in tuple(self._running):
            missing = missing_meanwhile(self._domain, running.step, state)
            if missing is not None:
                self._release([running])
                self._want(Decision(because(self._domain, running.step, missing, verb="became"), is_needed=True))
        if self._course is not None:
            flaw = self._flaw(self._course, self._belief.observe())
            news = news_of(self._expected, (state, self._belief.numbers))
            self._want(decide(self._policy, flaw=flaw, goals_changed=goals_changed, news=news))

    def _flaw(self, course: Course, state: State) -> str | None:
        """Why the rest of the plan will not do any more, in words; looked for again only when something is new."""
        now = (state, self._belief.numbers)
        if self._found_valid is not None and self._found_valid[0] is course and self._found_valid[1] == now:
            return None
        if self._replanning.had_no_plan and self._replanning.why_hopeless(self._unstarted(state)) is None:
            return "the state changed"
        flaw = course.replay(state).flaw or self._quest.overspent(course)
        self._found_valid = (course, now) if flaw is None else None
        return flaw

    def _want(self, decision: Decision | None) -> None:
        """Note that a plan is to be made; one that is needed makes an end of the present one."""
        if decision is None:
            return
        self._replanning.want(decision)
        if decision.is_needed:
            self._course = None
            if self._policy.while_planning == "hold":
                self._release(self._running)

    def _conclude(self, state: State) -> Status:
        """Say how the tick ends, and ask for a plan if one is wanted."""
        if not self._running and self._quest.is_over(state, self.goals, self._course):
            self._drop_plan()
            self.feedback_message = "the goal holds"
            return Status.SUCCESS
        planned_from = self._unstarted(state)
        if not self._replanning.is_busy and (self._course is None or self._course.is_finished):
            why = self._replanning.why_hopeless(planned_from)
            if why is not None:
                self._drop_plan()
                self.feedback_message = why
                return Status.FAILURE
            reason = "the state changed" if self._replanning.had_no_plan else "start"
            self._want(Decision(reason, is_needed=True))
        asked = self._replanning.ask_if_allowed(planned_from)
        if asked is not None:
            self._ended_meanwhile.clear()
            self.feedback_message = asked
        elif self._running and not self._replanning.is_busy:
            self.feedback_message = ", ".join(str(step) for step in self.current_steps)
        self._bridge()
        return Status.RUNNING

    def _bridge(self) -> None:
        """Do what is done between two steps, or let go of it: not before the next step has begun."""
        if self._running:
            self._interlude.end()
        else:
            self._ticked += self._interlude.go_on(self._setup_arguments)
            self.children = self._interlude.behaviours

    def _unstarted(self, state: State) -> State:
        """Return the state to plan from: as if no step ran, so that the plan may start with what runs."""
        return without((running.undo for running in self._running), state)

    # ---------------------------------------------------------------- a new plan

    def _take_plan(self) -> None:
        if not self._replanning.has_answer:
            return
        found = self._replanning.take(self._unstarted(self._belief.observe()))
        if found is None:
            return
        course = self._with_what_ended(found.course)
        kept: dict[int, RunningStep] = {}
        for running in self._running:
            number = course.starts_with(running.step)
            if number is not None:
                kept[number] = running
                course = course.with_event(Event(number, False))
        others = [running for running in self._running if running not in kept.values()]
        state = self._belief.observe()
        after = without((running.undo for running in others), state)
        old = None if found.decision.is_needed else self._course
        if old is not None and not self._quest.is_better(course, after, old, state, self.goals):
            return
        self._release(others)
        for number, running in kept.items():
            running.number = number
        self._course = course

    def _with_what_ended(self, course: Course) -> Course:
        """Return a plan less the steps that it starts with and that ended well while it was made."""
        for step in self._ended_meanwhile:
            number = course.starts_with(step)
            if number is not None:
                course = course.with_event(Event(number, False), Event(number, True))
        return course

    # ---------------------------------------------------------------- executing

    def _start_ready(self) -> tuple[RunningStep, ...]:
        """Start the steps that may start; return them."""
        begun: list[RunningStep] = []
        while self._course is not None and self._course.startable:
            state = self._belief.observe()
            if self._quest.is_over(state, self.goals, self._course):
                break
            flaw = self._flaw(self._course, state)
            if flaw is not None:
                self._want(Decision(flaw, is_needed=True))
                break
            begun.append(self._begin(self._course, self._course.startable[0], state))
        return tuple(begun)

    def _begin(self, course: Course, number: int, state: State) -> RunningStep:
        step = course.steps[number]
        running = RunningStep(step, self._factories[step.schema], number, self, self._setup_arguments)
        running.undo = self._belief.start(step, state)
        self._running.append(running)
        self.children = [one.behaviour for one in self._running]
        self._course = course.with_event(Event(number, False))
        return running

    def _tick_steps(self, steps: tuple[RunningStep, ...]) -> bool:
        """Tick steps; return whether one has ended well, so that others may start."""
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
                self._want(Decision(wrong, is_needed=True))
            any_ended |= wrong is None
        return any_ended

    def _ended(self, running: RunningStep) -> str | None:
        """Believe the effects of a step that succeeded; or say why it cannot have."""
        step, state = running.step, self._belief.observe()
        missing = missing_at_end(self._domain, step, state)
        if missing is not None:
            return f"{step} ended although {missing} does not hold"
        self._belief.end(step, state)
        running.undo = Undo()
        self._release([running])
        if self._course is not None and running.number is not None:
            self._course = self._course.with_event(Event(running.number, True))
        self._ended_meanwhile.append(step)
        disappointed = self._hopes.ended(step, state)
        if disappointed and self._course is not None:
            self._lose_hope(self._course.with_domain(self._hopes.domain), disappointed)
        return None

    def _lose_hope(self, course: Course, disappointed: Iterable[Disappointment]) -> None:
        """Go on without what a step was hoped to make feasible, or have a plan made if the rest needs that."""
        state = self._belief.observe()
        hoped = state | {self._domain.feasible_atom(one.action) for one in disappointed}
        if course.replay(state).flaw is not None and course.replay(hoped).flaw is None:
            self._want(Decision("; ".join(map(str, disappointed)), is_needed=True))
        else:
            self._course = course

    def _release(self, steps: Iterable[RunningStep]) -> None:
        """Stop steps if they still run, take back what was believed because they had started, and let go of them."""
        for running in tuple(steps):
            self._running.remove(running)
            self.children = [one.behaviour for one in self._running]
            self._belief.take_back(running.undo)
            self._belief.use_up(running.step)
            running.release()
            self._interlude.follow(running.step)

    def _drop_plan(self) -> None:
        self._course = self._found_valid = self._expected = None
        self._replanning.forget()
        self._release(self._running)
        self._interlude.end()
        self.children = []
