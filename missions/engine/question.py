"""Planning by hand (`rosa plan`): a domain in a situation, and why there is no plan."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Final

from kb import KnowledgeBase, Model
from missions.engine.mission import Mission
from missions.engine.percepts import Percepts
from missions.engine.settings import MissionError
from missions.engine.task_layer import mission_domain
from rosa_pddl import (
    Certificate,
    Domain,
    Goal,
    Planner,
    PlanningResult,
    Problem,
    State,
    certificate,
    initial_state,
    load_domain,
)
from rosa_pddl.belief import ExpectedEffects
from rosa_pddl.domain import without_feasibility
from rosa_pddl.reader import atom_of, conditions
from rosa_pddl.replanning import diagnosis

FAILED: Final = "failed"


@dataclass(frozen=True)
class Question:
    """A domain, the state to plan from, and the goals.

    Attributes:
        kb: says which actions are feasible; the state does not.
        oversights: what may be mistakes in the domain or the model, as sentences.
        numbers: numeric facts for costs and limits, as far as the mission knows them.
        engine: name of the planning engine; None for the default.
        why_not: returns why there is no plan, as far as the mission can tell; empty if it cannot.
    """

    domain: Domain
    kb: KnowledgeBase
    state: State
    goals: tuple[Goal, ...]
    oversights: tuple[str, ...] = ()
    numbers: Mapping[str, float] = field(default_factory=dict)
    engine: str | None = None
    why_not: Callable[[], str] = str

    @property
    def problem(self) -> Problem:
        return self.problem_without(self.unfeasible)

    @property
    def unfeasible(self) -> tuple[str, ...]:
        actions = self.domain.rosa_actions
        return tuple(action for action in actions if not self.kb.is_feasible(action))

    def problem_without(self, unfeasible: Iterable[str]) -> Problem:
        """Return the problem in which exactly these ROSA actions are unfeasible."""
        domain = ExpectedEffects(self.domain, self.kb).domain
        left_out = set(unfeasible)
        feasible = {atom for atom, action in domain.feasibility.items() if action not in left_out}
        goals = tuple(goal.expression for goal in self.goals)
        return Problem(domain, self.state | feasible, goals, self.numbers)


@dataclass(frozen=True)
class Answer:
    """A plan, or why there is none, in sentences."""

    question: Question
    result: PlanningResult
    obstacles: tuple[str, ...] = ()


def ask(
    files: Sequence[Path] = (),
    mission: Mission | None = None,
    models: Sequence[Path] = (),
    kb: KnowledgeBase | None = None,
    *,
    situation: Iterable[str] = (),
    goals: Sequence[str] = (),
    engine: str | None = None,
) -> Question:
    """Build a question from a domain and a problem file, or from a mission, which has a model.

    Args:
        files: the two PDDL files; none for a mission.
        mission: the mission to plan for, if no files are given.
        models: files of the model that says what is feasible. Without a model every ROSA action is
            feasible, unless the problem file says otherwise.
        kb: of the robot that is to do the plan, if it runs.
        situation: assumed facts, such as "battery_level=0.2", or "camera=failed" for a component;
            also several, separated by commas.
        goals: conditions as text, which replace the goal of the problem.
        engine: name of the planning engine; None for that of the mission, or else the default.

    Raises:
        MissionError, KnowledgeBaseError, RosaPddlError: something is missing, unknown or cannot be
            read.
    """
    domain = load_domain(*files) if mission is None else mission_domain(mission)
    assumed = [part.strip() for text in situation for part in text.split(",")]
    if not all(text.strip() for text in goals):
        hint = "give a condition such as '(found it)', or leave it out"
        raise MissionError(f"--goal is empty; {hint}")
    if models:
        kb = KnowledgeBase(Model.load(models), clock=lambda: 0.0)
    elif mission is not None and kb is None:
        kb = KnowledgeBase(mission.model(), clock=lambda: 0.0)
    elif assumed:
        hint = "name its file with --model FILE, or a mission"
        raise MissionError(f"a situation is about a model; {hint}")
    elif kb is None:
        kb = _as_stated(domain)
    oversights = domain.check(kb)
    for text in assumed:
        _assume(kb, text)
    percepts = Percepts()  # nothing is sensed yet, so a fact that is false may only be unknown
    facts = {} if mission is None else mission.facts(kb, percepts)
    true = {atom_of(domain, text) for text, value in facts.items() if value is True}
    # a goal may be several conditions side by side
    texts = [f"(and {text})" for text in goals] if goals else domain.goals
    return Question(
        domain,
        kb,
        without_feasibility(domain, initial_state(domain) | true),
        tuple(condition for text in texts for condition in conditions(domain, text)),
        oversights,
        {text: value for text, value in facts.items() if not isinstance(value, bool)},
        mission.engine if mission and engine is None else engine,
        partial(mission.why_not, kb, percepts) if mission and not goals else str,
    )


def _assume(kb: KnowledgeBase, text: str) -> None:
    """Record an assumption: ATTRIBUTE=NUMBER or COMPONENT=failed."""
    name, _, value = (word.strip() for word in text.partition("="))
    if value == FAILED:
        kb.component_failed(name)
        return
    try:
        number = float(value)
    except ValueError as error:
        form = f"ATTRIBUTE=NUMBER or COMPONENT={FAILED}"
        raise MissionError(f"--situation takes {form}, not {text!r}") from error
    kb.measure(name, number)


def _as_stated(domain: Domain) -> KnowledgeBase:
    """Return a base without a model: all is feasible, or what the problem file says."""
    model = Model(domain.name)
    for action in domain.rosa_actions:
        model.action(action)
    kb = KnowledgeBase(model, clock=lambda: 0.0)
    stated = [atom for atom in initial_state(domain) if domain.is_feasibility(atom)]
    feasible = {domain.feasibility[atom] for atom in stated}
    for action in domain.rosa_actions:
        if stated and action not in feasible:
            reason = "the problem file does not state that it is feasible"
            kb.assert_status(kb.actions[action], "unfeasible", reason)
    return kb


def answer(question: Question, timeout_s: float) -> Answer:
    """Plan with the engine that is asked for, or `Planner()`; find out why there is no plan.

    Each planning may take `timeout_s` of wall clock time [s].
    """
    with closing(Planner(question.engine, timeout_s)) as planner:
        result = _plan(question, planner)
        if result.outcome.is_solved or result.outcome.is_trouble:
            return Answer(question, result)
        asking = diagnosis(question.problem, question.goals)
        try:
            problem = next(asking)
            while True:
                problem = asking.send(planner.plan(problem))
        except StopIteration as concluded:
            obstacles = (*concluded.value.sentences, question.why_not())
        return Answer(question, result, tuple(filter(None, obstacles)))


def certified(question: Question, timeout_s: float, failures: int | None) -> Certificate:
    """Plan for each set of at most `failures` unfeasible actions (None: any number).

    It also plans for each component that may fail: what cures one cause need not cure another.
    """
    with closing(Planner(question.engine, timeout_s)) as planner:
        table = certificate(question.domain, question.problem_without, planner, failures)
        entries = dict[tuple[str, ...], PlanningResult]()
        for out, result in table.entries.items():
            entries[out] = _with_assumptions(question, result, question.problem_without(out))
        causes = dict[str, PlanningResult]()
        for component in question.kb.model.components:
            kb = KnowledgeBase(question.kb.model, clock=lambda: 0.0)
            kb.component_failed(component)
            failing = replace(question, kb=kb)
            if failing.unfeasible:
                causes[f"{component} fails"] = _plan(failing, planner)
    return replace(table, entries=entries, causes=causes)


def _plan(question: Question, planner: Planner) -> PlanningResult:
    """Plan without promises that cannot be kept, with what the plan assumes."""
    problem = question.problem
    return _with_assumptions(question, planner.plan(problem), problem)


def _with_assumptions(
    question: Question, result: PlanningResult, problem: Problem
) -> PlanningResult:
    effects = ExpectedEffects(question.domain, question.kb)
    return replace(result, assumptions=effects.assumptions(result.steps, problem.state))
