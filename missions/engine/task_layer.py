"""The task layer of a mission: a behaviour tree or a plan executor, either way one behaviour to be ticked."""

from collections.abc import Callable
from dataclasses import dataclass
from inspect import signature
from typing import TYPE_CHECKING, Final, Protocol, runtime_checkable

from py_trees.behaviour import Behaviour
from py_trees.decorators import FailureIsRunning

from kb import KnowledgeBase
from missions.engine.mission import Mission, MissionError
from missions.engine.percepts import Percepts

if TYPE_CHECKING:
    from rosa_pddl import PlanRecord, Step

__all__ = ["Planning", "TASK_KINDS", "TaskLayer", "build_task", "check_task"]

TASK_KINDS: Final = ("bt", "pddl")


@runtime_checkable
class Planning(Protocol):
    """A behaviour that plans, such as `rosa_pddl.PlanExecutor`: a tree with one in it has its plans told."""

    @property
    def plans(self) -> tuple["PlanRecord", ...]:
        """The plans made so far; only added to."""


@dataclass(frozen=True, slots=True)
class TaskLayer:
    """What decides about actions.

    Attributes:
        root: the behaviour to tick.
        catch_up: to be called between ticks: waits for an answer that is due.
        plans: the task plans made so far, by a planner or by behaviours in a tree.
        is_planned: whether the actions are those of the plans, none of a tree's own.
        close: to be called at the end: lets go of what was used for planning.
    """

    root: Behaviour
    catch_up: Callable[[], None] = lambda: None
    plans: Callable[[], tuple["PlanRecord", ...]] = tuple
    close: Callable[[], None] = lambda: None
    is_planned: bool = False


def check_task(kind: str) -> None:
    """Raise unless there is that kind of task layer."""
    if kind not in TASK_KINDS:
        raise MissionError(f"unknown task layer {kind!r}; there are {' and '.join(TASK_KINDS)}")


def build_task(
    kind: str,
    mission: Mission,
    kb: KnowledgeBase,
    percepts: Percepts,
    clock: Callable[[], float],
    planning_delay_s: float,
) -> TaskLayer:
    """Build the task layer of a mission.

    Args:
        kind: "bt" or "pddl".
        mission: whose task logic.
        kb: the knowledge base that the task layer asks and tells.
        percepts: what else it is told.
        clock: gives the time [s].
        planning_delay_s: simulated time in which a plan is found [s].

    Raises:
        MissionError: no such kind, or the mission has no task logic of that kind.
    """
    check_task(kind)
    if kind == "bt":
        root = mission.tree(kb, percepts)
        if not isinstance(root, Behaviour):
            raise MissionError(f"the tree of mission {mission.name} is {root!r}, not a py_trees behaviour")
        return TaskLayer(root, plans=_Plans(root))
    return _planning(mission, kb, percepts, clock, planning_delay_s)


def _planning(
    mission: Mission, kb: KnowledgeBase, percepts: Percepts, clock: Callable[[], float], delay_s: float
) -> TaskLayer:
    from missions.planning.declared import check_facts, mission_domain
    from rosa_pddl import PlanExecutor, Planner

    check_facts(mission)
    domain = mission_domain(mission)
    planner = Planner(mission.engines[0], fallback=mission.engines[1:]) if mission.engines else Planner()
    missing = planner.missing(domain)
    if missing is not None:
        raise MissionError(missing)
    made = _Made(kb, percepts)
    executor = PlanExecutor(
        f"plan for {mission.name}",
        kb=kb,
        domain=domain,
        behaviours={schema: made.by(schema, action) for schema, action in mission.actions.items()},
        sense=lambda: mission.facts(kb, percepts),
        clock=clock,
        planner=planner,
        delay_s=delay_s,
    )
    root = FailureIsRunning("until the goal holds", executor)

    def catch_up() -> None:
        executor.catch_up()
        if made.error is not None:
            raise made.error

    return TaskLayer(root, catch_up, lambda: executor.plans, planner.close, is_planned=True)


class _Plans:
    """The plans of all behaviours of a tree that plan, in the order in which they are found here."""

    def __init__(self, root: Behaviour) -> None:
        self._planning = [one for one in root.iterate() if isinstance(one, Planning)]
        self._heard = [0] * len(self._planning)
        self._plans: tuple[PlanRecord, ...] = ()

    def __call__(self) -> tuple["PlanRecord", ...]:
        """Return them."""
        for number, one in enumerate(self._planning):
            plans = one.plans
            if len(plans) > self._heard[number]:
                self._plans += plans[self._heard[number] :]
                self._heard[number] = len(plans)
        return self._plans


class _Made:
    """Makes the behaviours of steps, and keeps the error if one cannot be made: a tree would make a failure of it.

    Attributes:
        error: what making the latest raised; None if it was made.
    """

    def __init__(self, kb: KnowledgeBase, percepts: Percepts) -> None:
        self.error: Exception | None = None
        self._kb, self._percepts = kb, percepts

    def by(self, schema: str, action: Callable[..., Behaviour]) -> Callable[["Step"], Behaviour]:
        """Return what makes the behaviour of a step; it is told the step if it asks for it.

        Raises:
            MissionError: it asks for something else, too.
        """
        parameters = signature(action)
        is_told = "step" in parameters.parameters
        try:
            parameters.bind(self._kb, self._percepts, **({"step": None} if is_told else {}))
        except TypeError as error:
            given = "the knowledge base, the percepts and, as `step`, the step"
            raise MissionError(f"what does the PDDL action {schema} is given {given}: {error}") from error

        def make(step: "Step") -> Behaviour:
            try:
                made = action(self._kb, self._percepts, **({"step": step} if is_told else {}))
                if not isinstance(made, Behaviour):
                    raise MissionError(f"what does the PDDL action {schema} is {made!r}, not a py_trees behaviour")
                return made
            except Exception as error:
                self.error = error
                raise

        return make
