"""The task layer of a mission: its tree, or a plan executor for its PDDL."""

from collections.abc import Callable, Sequence
from functools import partial
from inspect import signature
from pathlib import Path
from typing import Any, Final

from py_trees.behaviour import Behaviour
from py_trees.decorators import Decorator, FailureIsRunning

from kb import KnowledgeBase
from missions.engine.mission import Mission, built
from missions.engine.percepts import Percepts
from missions.engine.settings import MissionError, RunSettings
from rosa_pddl import (
    Domain,
    LastingFeasibility,
    PlanExecutor,
    Planner,
    PlanRecord,
    Step,
    load_domain,
    parse_domain,
)

TASK_KINDS: Final = ("bt", "pddl")


class TaskLayer:
    """The behaviour to tick, and the task plans of all behaviours in it that plan.

    A behaviour with `catch_up`, such as `rosa_pddl.PlanExecutor`, waits for due answers there.

    Attributes:
        close: releases what was used for planning; call it at the end.
        errors: exceptions of behaviours that could not be built, which end the run.
        is_planned: whether all actions come from plans, and none from a tree.
    """

    def __init__(
        self,
        root: Behaviour,
        close: Callable[[], None] = lambda: None,
        errors: Sequence[Exception] = (),
    ) -> None:
        self.root = root
        self.close = close
        self.errors = errors
        self._planning: list[Any] = [part for part in root.iterate() if has_plans(part)]
        self._waiting = [part for part in self._planning if hasattr(part, "catch_up")]
        while isinstance(root, Decorator):
            root = root.decorated
        self.is_planned = root in self._waiting

    def catch_up(self) -> None:
        """Wait for answers that are due; call it between ticks."""
        for behaviour in self._waiting:
            behaviour.catch_up()
        if self.errors:
            raise self.errors[0]

    def plans(self) -> tuple[PlanRecord, ...]:
        """Return the last plans of all behaviours, in the order in which they were asked for."""
        plans = [plan for behaviour in self._planning for plan in behaviour.plans]
        return tuple(sorted(plans, key=lambda plan: plan.at_s))

    def findings(self) -> Sequence[str]:
        """Return what may be mistakes in the PDDL, as sentences, each once."""
        texts = [text for part in self._planning for text in getattr(part, "findings", ())]
        return list(dict.fromkeys(texts))


def has_plans(behaviour: Behaviour) -> bool:
    """Whether a behaviour plans: it then has `plans`, a tuple of `rosa_pddl.PlanRecord`."""
    return isinstance(getattr(behaviour, "plans", None), tuple)


def check_task(kind: str) -> None:
    if kind not in TASK_KINDS:
        raise MissionError(f"unknown task layer {kind!r}; there are {' and '.join(TASK_KINDS)}")


def build_task(
    kind: str,
    mission: Mission,
    kb: KnowledgeBase,
    percepts: Percepts,
    settings: RunSettings | None = None,
) -> TaskLayer:
    """Build the task layer "bt" or "pddl"; only the latter has settings.

    Raises:
        MissionError: no such kind, or the mission has no task logic of that kind.
    """
    check_task(kind)
    if kind == "bt":
        if mission.tree is None:
            hint = "run it with --task pddl, or give it tree=..."
            raise MissionError(f"mission {mission.name} has no tree; {hint}")
        build = partial(mission.tree, kb, percepts)
        return TaskLayer(built(f"the tree of mission {mission.name}", Behaviour, build))  # type: ignore[type-abstract]  # only for isinstance
    settings = settings or RunSettings()
    domain = mission_domain(mission)
    planner = Planner(mission.engine)
    missing = planner.missing()
    if missing is not None:
        raise MissionError(missing)
    errors: list[Exception] = []
    factories = {}
    for schema, action in mission.actions.items():
        factories[schema] = _factory(schema, action, kb, percepts, errors)
    executor = PlanExecutor(
        f"plan for {mission.name}",
        kb=LastingFeasibility(kb, domain) if settings.plan_ahead else kb,
        domain=domain,
        behaviours=factories,
        sense=lambda: mission.facts(kb, percepts),
        clock=lambda: kb.now,
        planner=planner,
        delay_s=settings.planning_delay_s,
    )
    return TaskLayer(FailureIsRunning("until the goal holds", executor), planner.close, errors)


def _factory(
    schema: str,
    action: Callable[..., Behaviour],
    kb: KnowledgeBase,
    percepts: Percepts,
    errors: list[Exception],
) -> Callable[[Step], Behaviour]:
    """Return a function that builds the behaviour of a step, and adds what it raises to `errors`.

    The executor alone would take an exception for a failed step.
    """
    has_step = "step" in signature(action).parameters
    title = f"the behaviour of the PDDL action {schema}"

    def build(step: Step) -> Behaviour:
        build_behaviour = partial(action, kb, percepts, **({"step": step} if has_step else {}))
        try:
            return built(title, Behaviour, build_behaviour)  # type: ignore[type-abstract]  # only for isinstance
        except Exception as error:
            errors.append(error)
            raise

    return build


def mission_domain(mission: Mission) -> Domain:
    """Return the domain and problem of a mission.

    Raises:
        MissionError: it lacks one of the two.
    """
    problem = mission.problem
    if mission.domain is None or problem is None:
        lacking = "domain" if mission.domain is None else "problem"
        hint = f"run it with --task bt, or give it {lacking}=..."
        raise MissionError(f"mission {mission.name} has no PDDL {lacking}; {hint}")
    if not callable(problem):
        return load_domain(mission.domain, problem)
    text = built(f"the problem of mission {mission.name}", str, problem)
    return parse_domain(Path(mission.domain).read_text(), text)
