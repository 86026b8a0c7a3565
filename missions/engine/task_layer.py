"""The task layer of a mission: its tree, or a plan executor for its PDDL, which is read from files."""

from collections.abc import Callable, Sequence
from functools import partial
from inspect import signature
from typing import Any, Final

from py_trees.behaviour import Behaviour
from py_trees.decorators import Decorator, FailureIsRunning

from kb import KnowledgeBase
from missions.engine.adaptations import plans_after
from missions.engine.mission import Mission, MissionError, Percepts, built
from rosa_pddl import (
    Domain,
    PlanExecutor,
    Planner,
    PlanRecord,
    Step,
    load_domain,
    parse_domain,
)

TASK_KINDS: Final = ("bt", "pddl")
Action = Callable[..., Behaviour]


class TaskLayer:
    """The behaviour to tick, and the task plans of all behaviours in it that plan.

    A behaviour with `catch_up`, such as `rosa_pddl.PlanExecutor`, waits for due answers there, between ticks.

    Attributes:
        close: releases what was used for planning; call it at the end.
        is_planned: whether all actions come from plans, and none from a tree.
    """

    def __init__(
        self, root: Behaviour, close: Callable[[], None] = lambda: None, made: "Made | None" = None
    ) -> None:
        self.root, self.close, self._made = root, close, made
        self._planning: list[Any] = [one for one in root.iterate() if has_plans(one)]
        self._waiting = [one for one in self._planning if hasattr(one, "catch_up")]
        self._heard: list[PlanRecord | None] = [None] * len(self._planning)
        self._plans: tuple[PlanRecord, ...] = ()
        while isinstance(root, Decorator):
            root = root.decorated
        self.is_planned = root in self._waiting

    def catch_up(self) -> None:
        """Wait for answers that are due; call it between ticks. Raises the error of a behaviour that cannot be made."""
        for one in self._waiting:
            one.catch_up()
        if self._made is not None and self._made.error is not None:
            raise self._made.error

    def plans(self) -> tuple[PlanRecord, ...]:
        """Return the last plans, in the order in which this method found them, numbered from 1."""
        for number, one in enumerate(self._planning):
            for plan in plans_after(self._heard[number], one.plans):
                self._heard[number] = plan
                self._plans = plan.added_to(self._plans)
        return self._plans

    def findings(self) -> Sequence[str]:
        """Return what may be mistakes in the PDDL, as sentences, each once."""
        return list(
            dict.fromkeys(text for one in self._planning for text in getattr(one, "findings", ()))
        )


def has_plans(behaviour: Behaviour) -> bool:
    """Whether a behaviour plans: it then has `plans`, a tuple of `rosa_pddl.PlanRecord`."""
    return isinstance(getattr(behaviour, "plans", None), tuple)


def check_task(kind: str) -> None:
    if kind not in TASK_KINDS:
        raise MissionError(f"unknown task layer {kind!r}; there are {' and '.join(TASK_KINDS)}")


def build_task(
    kind: str, mission: Mission, kb: KnowledgeBase, percepts: Percepts, delay_s: float = 0.0
) -> TaskLayer:
    """Build the task layer of a mission: kind "bt" or "pddl"; finding a plan takes `delay_s` of simulated time [s].

    Raises:
        MissionError: no such kind, or the mission has no task logic of that kind.
    """
    check_task(kind)
    if kind == "bt":
        if mission.tree is None:
            raise MissionError(
                f"mission {mission.name} has no tree; run it with --task pddl, or give it tree=..."
            )
        return TaskLayer(
            built(
                f"the tree of mission {mission.name}",
                Behaviour,  # type: ignore[type-abstract]  # only for isinstance
                partial(mission.tree, kb, percepts),
            )
        )
    domain = mission_domain(mission)
    planner, made = planner_of(mission, domain), Made(kb, percepts)
    executor = PlanExecutor(
        f"plan for {mission.name}",
        kb=kb,
        domain=domain,
        behaviours={schema: made.by(schema, action) for schema, action in mission.actions.items()},
        sense=lambda: mission.facts(kb, percepts),
        clock=lambda: kb.now,
        planner=planner,
        delay_s=delay_s,
    )
    return TaskLayer(FailureIsRunning("until the goal holds", executor), planner.close, made)


def planner_of(mission: Mission, domain: Domain) -> Planner:
    """Return the planner for a mission; MissionError if its engine is missing or cannot plan in that domain."""
    planner = (
        Planner(mission.engines[0], fallback=mission.engines[1:]) if mission.engines else Planner()
    )
    if (missing := planner.missing()) is not None:
        raise MissionError(missing)
    return planner


class Made:
    """Makes the behaviours of steps; keeps an exception as `error`, as the executor takes it for a failed step."""

    def __init__(self, kb: KnowledgeBase, percepts: Percepts) -> None:
        self.error: Exception | None = None
        self._given = kb, percepts

    def by(self, schema: str, action: Action) -> Callable[[Step], Behaviour]:
        """Return a function that makes the behaviour of a step; an action with a parameter `step` is given the step."""
        parameters = signature(action)
        names = [name for name in parameters.parameters if name == "step"]
        what = f"what does the PDDL action {schema} is"
        try:
            parameters.bind(*self._given, **dict.fromkeys(names))
        except TypeError as error:
            given = "the knowledge base, the percepts and, as `step`, the step"
            raise MissionError(f"{what} given {given}: {error}") from error

        def make(step: Step) -> Behaviour:
            try:
                made = action(*self._given, **dict.fromkeys(names, step))
                if not isinstance(made, Behaviour):
                    raise MissionError(f"{what} {made!r}, not a py_trees behaviour")
            except Exception as error:
                self.error = error
                raise
            return made

        return make


# -------------------------------------------------------------------- the PDDL of a mission


def mission_domain(mission: Mission) -> Domain:
    """Return the domain and problem of a mission; MissionError if it lacks one of the two."""
    problem = mission.problem
    if mission.domain is None or problem is None:
        lacking = "domain" if mission.domain is None else "problem"
        message = f"mission {mission.name} has no PDDL {lacking}"
        raise MissionError(f"{message}; run it with --task bt, or give it {lacking}=...")
    if not callable(problem):
        return load_domain(mission.domain, problem)
    text = built(f"the problem of mission {mission.name}", str, problem)
    return parse_domain(mission.domain.read_text(), text)
