"""Planning by hand (`rosa plan`): a domain in a situation, the planner's answer, and why there is no plan."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Final

from kb import KnowledgeBase, Model
from missions.engine.mission import Mission, MissionError, Percepts
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
from rosa_pddl.belief import assumptions, without_hopeless
from rosa_pddl.domain import without_feasibility
from rosa_pddl.exceptions import nearest
from rosa_pddl.reader import conditions
from rosa_pddl.replanning import diagnosis

FAILED: Final = "failed"


@dataclass(frozen=True)
class Question:
    """A domain, the state to plan from, and the goals.

    Attributes:
        kb: says which actions are feasible; the state does not.
        oversights: what may be mistakes in the domain or the model, as sentences.
        numbers: numeric facts for costs and limits, as far as the mission knows them.
        engines: names of planning engines; empty: those that the domain needs.
        why_not: returns why there is no plan, as far as the mission can tell; empty if it cannot.
        is_supposed: whether it is supposed which actions are feasible.
    """

    domain: Domain
    kb: KnowledgeBase
    state: State
    goals: tuple[Goal, ...]
    oversights: tuple[str, ...] = ()
    numbers: Mapping[str, float] = field(default_factory=dict)
    engines: tuple[str, ...] = ()
    why_not: Callable[[], str] = str
    is_supposed: bool = False

    @property
    def problem(self) -> Problem:
        return self.supposing(self.unfeasible)

    @property
    def unfeasible(self) -> tuple[str, ...]:
        return tuple(
            action for action in self.domain.rosa_actions if not self.kb.is_feasible(action)
        )

    def supposing(self, unfeasible: Iterable[str]) -> Problem:
        """Return the problem in which exactly these ROSA actions are unfeasible."""
        left_out = set(unfeasible)
        # where it is supposed what is feasible, nobody knows why the rest is not
        domain = self.domain if self.is_supposed else without_hopeless(self.domain, self.kb)
        state = self.state | {
            atom for atom, action in domain.feasibility.items() if action not in left_out
        }
        return Problem(domain, state, tuple(goal.expression for goal in self.goals), self.numbers)


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
    *,
    situation: Iterable[str] = (),
    feasible: Iterable[str] | None = None,
    goals: Sequence[str] = (),
) -> Question:
    """Make a question from a domain and a problem file, or from a mission, which also has the model.

    Args:
        files: the two PDDL files; none for a mission.
        mission: the mission to plan for, if no files are given.
        models: files of the model that says what is feasible. Without a model every ROSA action is feasible, unless
            `feasible` or the problem file says otherwise.
        situation: assumed facts, such as "battery_level=0.2", or "camera=failed" for a component; also several,
            separated by commas.
        feasible: the ROSA actions that are feasible, all others are not; also several, separated by commas. None: the
            knowledge base decides.
        goals: conditions as text, which replace the goal of the problem.

    Raises:
        MissionError, KnowledgeBaseError, RosaPddlError: something is missing, unknown or cannot be read.
    """
    domain = _domain(files, mission)
    supposed, has_model = dict(_read(situation)), bool(models or mission)
    if supposed and not has_model:
        raise MissionError(
            "a situation is about a model; name its file with --model FILE, or a mission"
        )
    if supposed and feasible is not None:
        raise MissionError(
            "what is feasible follows from the situation; give --feasible or --situation, not both"
        )
    kb = KnowledgeBase(_model(domain, mission, models), clock=lambda: 0.0)
    oversights = domain.check(kb)
    for name, value in supposed.items():
        if value is None:
            kb.component_failed(name)
        else:
            kb.measure(name, value)
    _suppose_feasible(kb, domain, feasible, has_model)
    percepts = Percepts()  # nothing is sensed yet, so a fact that is false may only be unknown
    facts = {} if mission is None else mission.facts(kb, percepts)
    true = {domain.atom(text) for text, value in facts.items() if value is True}
    numbers = {text: value for text, value in facts.items() if not isinstance(value, bool)}
    state = without_feasibility(domain, initial_state(domain) | true)
    if not all(text.strip() for text in goals):
        raise MissionError(
            "--goal is empty; give a condition such as '(found it)', or leave it out"
        )
    # a goal may be several conditions side by side
    texts = [f"(and {text})" for text in goals] if goals else domain.goals
    wanted = tuple(condition for text in texts for condition in conditions(domain, text))
    engines = () if mission is None else mission.engines
    why_not = str if mission is None or goals else partial(mission.why_not, kb, percepts)
    is_supposed = feasible is not None
    return Question(domain, kb, state, wanted, oversights, numbers, engines, why_not, is_supposed)


def _read(situation: Iterable[str]) -> Iterator[tuple[str, float | None]]:
    """Yield each assumption: an attribute with its value, or a component that has failed with None."""
    for part in (part.strip() for text in situation for part in text.split(",")):
        name, equals, value = (word.strip() for word in part.partition("="))
        if not equals or not name:
            raise MissionError(
                f"--situation takes ATTRIBUTE=NUMBER or COMPONENT={FAILED}, not {part!r}"
            )
        try:
            yield name, None if value == FAILED else float(value)
        except ValueError as error:
            message = (
                f"--situation takes {name}=NUMBER, or {name}={FAILED} for a component, not {part!r}"
            )
            raise MissionError(message) from error


def _domain(files: Sequence[Path], mission: Mission | None) -> Domain:
    if mission is not None:
        return mission_domain(mission)
    if len(files) != 2:
        raise MissionError(
            "nothing to plan; give a domain and a problem file, or a mission with --mission NAME"
        )
    return load_domain(*files)


def _model(domain: Domain, mission: Mission | None, models: Sequence[Path]) -> Model:
    if models:
        return Model.load(models)
    if mission is not None:
        return mission.model()
    model = Model(domain.name)
    for action in domain.rosa_actions:
        model.action(action)
    return model


def _suppose_feasible(
    kb: KnowledgeBase, domain: Domain, given: Iterable[str] | None, has_model: bool
) -> None:
    if given is not None:
        feasible, reason = _known(domain, given), "it is not among those given as feasible"
    else:
        stated = [atom for atom in initial_state(domain) if domain.is_feasibility(atom)]
        if has_model or not stated:
            return
        feasible = {domain.feasibility[atom] for atom in stated}
        reason = "the problem file does not state that it is feasible"
    for action in domain.rosa_actions:
        if kb.is_feasible(action) != (action in feasible):
            status = "feasible" if action in feasible else "unfeasible"
            kb.assert_status(kb.actions[action], status, reason)


def _known(domain: Domain, texts: Iterable[str]) -> set[str]:
    spelled = {action.lower(): action for action in domain.rosa_actions}
    names = [name.strip() for text in texts for name in text.split(",") if name.strip()]
    for name in names:
        if name.lower() not in spelled:
            message = f"--feasible names {name!r}, which is no ROSA action of {domain.file}"
            raise MissionError(f"{message}; {nearest(name, domain.rosa_actions)}")
    return {spelled[name.lower()] for name in names}


def answer(question: Question, timeout_s: float) -> Answer:
    """Plan with the engines of the mission, or else as `Planner()`; find out why there is no plan.

    Each planning may take `timeout_s` of wall clock time [s].
    """
    with closing(_planner(question, timeout_s)) as planner:
        result = planned(question, planner)
        has_proof = not result.outcome.is_solved and not result.outcome.is_trouble
        return Answer(question, result, _obstacles(question, planner) if has_proof else ())


def planned(question: Question, planner: Planner) -> PlanningResult:
    """Plan without promises that cannot be kept, and say what the plan assumes."""
    result = planner.plan(question.problem)
    if question.is_supposed:
        return result
    state = question.problem.state
    sentences = assumptions(question.domain, question.kb, result.steps, state)
    return replace(result, assumptions=sentences)


def certified(question: Question, timeout_s: float, failures: int | None) -> Certificate:
    """Plan for each set of at most `failures` unfeasible actions (None: any number).

    It also plans for each component that may fail: what cures one cause need not cure another.
    """
    with closing(_planner(question, timeout_s)) as planner:
        table = certificate(question.domain, question.supposing, planner, failures)
        causes = dict[str, PlanningResult]()
        for component in question.kb.model.components:
            kb = KnowledgeBase(question.kb.model, clock=lambda: 0.0)
            kb.component_failed(component)
            if any(not kb.is_feasible(action) for action in question.domain.rosa_actions):
                causes[f"{component} fails"] = planned(replace(question, kb=kb), planner)
    return replace(table, causes=causes)


def _planner(question: Question, timeout_s: float) -> Planner:
    engine, *fallback = question.engines or (None,)
    return Planner(engine, timeout_s, fallback=[name for name in fallback if name])


def _obstacles(question: Question, planner: Planner) -> tuple[str, ...]:
    """Return why there is no plan, without what the planner could not find out in time."""
    asking = diagnosis(question.problem, question.goals)
    try:
        asked = next(asking)
        while True:
            asked = asking.send(planner.plan(asked))
    except StopIteration as concluded:
        return tuple(filter(None, (*concluded.value.sentences, question.why_not())))
