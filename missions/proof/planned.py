"""A plan executor for exploration: plans arrive within the tick, behaviours are made once, and pauses are over."""

from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import Future

from py_trees.behaviour import Behaviour
from py_trees.common import Status
from py_trees.composites import Sequence
from py_trees.decorators import Decorator, FailureIsRunning

from kb import KnowledgeBase
from missions.engine.mission import Mission, Percepts
from missions.engine.task_layer import Made, mission_domain, planner_of
from rosa_pddl import Domain, PlanExecutor, Planner, PlanningResult, Step
from rosa_pddl.grounding import Grounded
from rosa_pddl.planner import awaited
from rosa_pddl.problem import Problem, initial_state


class _AtOnce:
    """A planner that waits for the answer when it is asked."""

    def __init__(self, planner: Planner) -> None:
        self._planner, self.timeout_s = planner, planner.timeout_s

    def start(self, problem: Problem) -> "Future[PlanningResult]":
        found = self._planner.start(problem)
        awaited(found, self.timeout_s)
        return found


class Planned(Decorator):
    """A plan executor whose pauses are all over before the next tick, so a step that failed is planned with again.

    Attributes:
        steps: the behaviours of all steps that plans may have.
    """

    def __init__(self, executor: PlanExecutor, steps: Mapping[Step, Behaviour]) -> None:
        super().__init__(f"until {executor.name} is done", FailureIsRunning("until the goal holds", executor))
        self.steps, self._executor = tuple(steps.values()), executor

    def tick(self) -> Iterator[Behaviour]:
        """Tick as if all that the executor waits for were over."""
        self._executor.wait_no_more()
        yield from super().tick()

    def update(self) -> Status:
        """Return the status of the executor; reset the status of ended steps, which decides nothing any more."""
        for one in self.steps:
            one.status = one.status if one.status is Status.RUNNING else Status.INVALID
        return self.decorated.status


def nodes(root: Behaviour) -> list[Behaviour]:
    """Return the nodes of a tree, including those of all steps that its plans may have."""
    every = list(root.iterate())
    steps = [step for one in every if isinstance(one, Planned) for step in one.steps]
    return list(dict.fromkeys([*every, *(node for step in steps for node in step.iterate())]))


def stage_of(root: Behaviour) -> tuple[object, ...]:
    """Return the progress of a tree: the current child of each running sequence with memory, and executors' beliefs."""
    every = nodes(root)
    sequences = [one for one in every if isinstance(one, Sequence) and one.memory]
    places = [one.current_child and one.current_child.name for one in sequences if one.status is Status.RUNNING]
    return (*places, *(one.state for one in every if isinstance(one, PlanExecutor)))


def planned(mission: Mission) -> Callable[[KnowledgeBase], Behaviour]:
    """Return a function that makes a mission's plan executor; it believes the effects of steps and senses nothing."""
    domain = mission_domain(mission)
    planner, steps = _AtOnce(planner_of(mission, domain)), _steps(domain)

    def build(kb: KnowledgeBase) -> Behaviour:
        made = Made(kb, Percepts())
        behaviours = {step: made.by(step.schema, mission.actions[step.schema])(step) for step in steps}
        executor = PlanExecutor(
            f"plan for {mission.name}",
            kb=kb,
            domain=domain,
            behaviours=dict.fromkeys(mission.actions, behaviours.__getitem__),
            sense=dict,
            clock=lambda: kb.now,
            planner=planner,
            delay_s=None,
        )
        return Planned(executor, behaviours)

    return build


def _steps(domain: Domain) -> list[Step]:
    """Return all steps that are reachable from the initial state, whatever becomes feasible."""
    feasible = map(domain.feasible_atom, domain.rosa_actions if domain.tracks_feasibility else ())
    first = initial_state(domain).union(feasible)
    task = Grounded(domain, first, first, lambda instances: None)
    return [task.step(number) for number in range(task.size)]
