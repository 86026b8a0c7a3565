"""What decides about a mission's actions: its tree, or a plan executor on the PDDL that it has or declares."""

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from inspect import signature
from typing import Any, Final

from py_trees.behaviour import Behaviour
from py_trees.decorators import Decorator, FailureIsRunning

from kb import KnowledgeBase
from missions.engine.mission import Mission, MissionError, Percepts, built
from rosa_pddl import (
    ActionSchema,
    Declarations,
    DeclaredProblem,
    Domain,
    PlanExecutor,
    Planner,
    PlanRecord,
    Step,
    load_domain,
)

TASK_KINDS: Final = ("bt", "pddl")
Action = Callable[..., Behaviour]


class TaskLayer:
    """What decides about actions: the behaviour to tick, and the task plans of all behaviours in it that plan.

    One that can `catch_up`, as `rosa_pddl.PlanExecutor`, waits between ticks for an answer that is due: no tick does.

    Attributes:
        close: to be called at the end: lets go of what was used for planning.
        is_planned: whether the actions are those of the plans, none of a tree's own.
    """

    def __init__(self, root: Behaviour, close: Callable[[], None] = lambda: None, made: "Made | None" = None) -> None:
        self.root, self.close, self._made = root, close, made
        self._planning: list[Any] = [one for one in root.iterate() if has_plans(one)]
        self._waiting = [one for one in self._planning if hasattr(one, "catch_up")]
        self._heard = [0] * len(self._planning)
        self._plans: tuple[PlanRecord, ...] = ()
        while isinstance(root, Decorator):
            root = root.decorated
        self.is_planned = root in self._waiting

    def catch_up(self) -> None:
        """Wait for answers that are due; to be called between ticks."""
        for one in self._waiting:
            one.catch_up()
        if self._made is not None and self._made.error is not None:
            raise self._made.error

    def plans(self) -> tuple[PlanRecord, ...]:
        """Return the plans so far, in the order in which they are found here."""
        for number, one in enumerate(self._planning):
            if len(one.plans) > self._heard[number]:
                self._plans += one.plans[self._heard[number] :]
                self._heard[number] = len(one.plans)
        return self._plans

    def findings(self) -> Sequence[str]:
        """Return what may be an oversight in what is planned with, once each."""
        return list(dict.fromkeys(text for one in self._planning for text in getattr(one, "findings", ())))


def has_plans(behaviour: Behaviour) -> bool:
    """Whether a behaviour plans: its `plans`, a tuple of `rosa_pddl.PlanRecord`, are then those of the run."""
    return isinstance(getattr(behaviour, "plans", None), tuple)


def check_task(kind: str) -> None:
    if kind not in TASK_KINDS:
        raise MissionError(f"unknown task layer {kind!r}; there are {' and '.join(TASK_KINDS)}")


def build_task(kind: str, mission: Mission, kb: KnowledgeBase, percepts: Percepts, delay_s: float = 0.0) -> TaskLayer:
    """Build the task layer of a mission, of a kind "bt" or "pddl"; a plan is found in that simulated time [s].

    Raises:
        MissionError: no such kind, or the mission has no task logic of that kind.
    """
    check_task(kind)
    if kind == "bt":
        if mission.tree is None:
            raise MissionError(f"mission {mission.name} has no tree; run it with --task pddl, or give it tree=...")
        return TaskLayer(built(f"the tree of mission {mission.name}", Behaviour, partial(mission.tree, kb, percepts)))  # type: ignore[type-abstract]  # only asked about
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
    """Return what plans for a mission; MissionError if it is not installed, or cannot plan in that domain."""
    planner = Planner(mission.engines[0], fallback=mission.engines[1:]) if mission.engines else Planner()
    if (missing := planner.missing(domain)) is not None:
        raise MissionError(missing)
    return planner


class Made:
    """Makes the behaviours of steps, and keeps the error if one cannot be made: a tree would make a failure of it."""

    def __init__(self, kb: KnowledgeBase, percepts: Percepts) -> None:
        self.error: Exception | None = None
        self._given = kb, percepts

    def by(self, schema: str, action: Action) -> Callable[[Step], Behaviour]:
        """Return what makes the behaviour of a step; it is given the step if it asks for it, and nothing else."""
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


def by_schema(*actions: Action) -> Mapping[str, Action]:
    """Return actions by the names that their schemas give them, for `Mission(actions=...)`.

    Raises:
        MissionError: one declares no schema, or two declare the same name.
    """
    named: dict[str, Action] = {}
    for action in actions:
        name = _schema_of(action).name
        if named.setdefault(name, action) is not action:
            raise MissionError(f"two actions declare the schema {name!r}; give each its own name")
    return named


def _schema_of(action: Action, name: str | None = None) -> ActionSchema:
    """Return what an action declares; MissionError if that is nothing, or has another name than it is listed under."""
    schema: Any = getattr(action, "schema", None)
    title = getattr(action, "__name__", repr(action))
    if not isinstance(schema, ActionSchema):
        advice = f"write schema = ActionSchema({name or title!r}, ...) in it, or give the mission a domain file"
        raise MissionError(f"the action {title} declares no schema; {advice}")
    if name not in (None, schema.name):
        raise MissionError(f"the action {title} is listed as {name!r}, but declares {schema.name!r}")
    return schema


def declarations_of(mission: Mission) -> Declarations | None:
    """Return what the PDDL of a mission is made of; None if it has files, or nothing to plan with."""
    given, title = mission.problem, f"the problem of mission {mission.name}"
    problem = built(title, DeclaredProblem, given) if callable(given) else given
    if mission.domain is not None or not isinstance(problem, DeclaredProblem):
        return None
    schemas = [_schema_of(action, name) for name, action in mission.actions.items()]
    return Declarations(mission.name, schemas, problem)


def mission_domain(mission: Mission) -> Domain:
    """Return the domain and problem of a mission; MissionError if it has none, or only one of two files."""
    declared = declarations_of(mission)
    if declared is not None:
        return declared.load()
    if mission.domain is None or mission.problem is None:
        raise MissionError(f"mission {mission.name} has no PDDL domain and problem; run it with --task bt")
    if isinstance(mission.problem, DeclaredProblem) or callable(mission.problem):
        raise MissionError(f"mission {mission.name} has a domain file but a declared problem; give both as files")
    return load_domain(mission.domain, mission.problem)
