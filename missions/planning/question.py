"""What is to be planned, asked by hand: a domain, what is feasible in some situation, and a goal."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Final

from kb import KnowledgeBase, Model
from missions.engine.mission import Mission, MissionError
from missions.engine.percepts import Percepts
from missions.planning.declared import check_facts, mission_domain
from rosa_pddl import Domain, Problem, State, feasible_atoms, initial_state, load_domain
from rosa_pddl.exceptions import nearest
from rosa_pddl.formulas import Condition, conditions
from rosa_pddl.problem import unlimited, without_feasibility

__all__ = ["Question", "Supposed", "ask", "read_situation"]

FAILED: Final = "failed"


@dataclass(frozen=True)
class Supposed:
    """What is supposed to be so.

    Attributes:
        feasible: the ROSA actions that are feasible, and no others; None to have the knowledge base say it.
        measured: values of attributes, in their units.
        failed: components that have failed.
    """

    feasible: tuple[str, ...] | None = None
    measured: Mapping[str, float] | None = None
    failed: tuple[str, ...] = ()


@dataclass(frozen=True)
class Question:
    """A domain, the state to plan from, and what shall be reached.

    Attributes:
        domain: what `load_domain` returned.
        kb: says what is feasible, and why not.
        state: the true atoms.
        goals: what shall hold.
        oversights: what may be one in the domain or the model, in sentences.
        numbers: what costs and limits are made of, as far as the mission knows it.
        engines: what plans, see `Mission`.
        why_not: says why there is no plan, as far as the mission can tell; empty if it cannot.
    """

    domain: Domain
    kb: KnowledgeBase
    state: State
    goals: tuple[Condition, ...]
    oversights: tuple[str, ...] = ()
    numbers: Mapping[str, float] = field(default_factory=dict)
    engines: tuple[str, ...] = ()
    why_not: Callable[[], str] = str

    @property
    def problem(self) -> Problem:
        """What a planner gets."""
        return self.supposing(self.unfeasible)

    @property
    def unfeasible(self) -> tuple[str, ...]:
        """The ROSA actions that cannot be done."""
        return tuple(action for action in self.domain.rosa_actions if not self.kb.is_feasible(action))

    @property
    def unlimited(self) -> "Question":
        """The same without the limits of resources."""
        return replace(self, domain=unlimited(self.domain))

    def supposing(self, unfeasible: Iterable[str], goals: Sequence[Condition] | None = None) -> Problem:
        """Return the problem in which just these ROSA actions are unfeasible, and perhaps something else is wanted."""
        left_out = set(unfeasible)
        state = without_feasibility(self.domain, self.state)
        if self.domain.tracks_feasibility:
            kept = [action for action in self.domain.rosa_actions if action not in left_out]
            state |= {self.domain.feasible_atom(action) for action in kept}
        wanted = self.goals if goals is None else goals
        return Problem(self.domain, state, tuple(goal.expression for goal in wanted), self.numbers)


def ask(
    files: Sequence[Path], mission: Mission | None, models: Sequence[Path], supposed: Supposed, goals: Sequence[str]
) -> Question:
    """Make a question of what is given.

    Without a model every ROSA action is feasible, unless something else is supposed or the problem file says so.

    Args:
        files: a domain and a problem.
        mission: gives them, and the model, if there are no files.
        models: files of the model, each may add to those before.
        supposed: what is so.
        goals: what shall be reached, as text; without any, the goal of the problem.

    Raises:
        MissionError, KnowledgeBaseError, RosaPddlError: something is missing, unknown or cannot be read.
    """
    domain = _domain(files, mission)
    _check(supposed, has_model=bool(models or mission))
    kb = KnowledgeBase(_model(domain, mission, models), clock=lambda: 0.0)
    oversights = domain.check(kb)
    for attribute, value in (supposed.measured or {}).items():
        kb.measure(attribute, value)
    for component in supposed.failed:
        kb.component_failed(component)
    _suppose_feasible(kb, domain, supposed, has_model=bool(models or mission))
    told = _told(mission, kb) if mission is not None and not files else {}
    true = {domain.atom(text) for text, value in told.items() if value is True}
    numbers = {text: value for text, value in told.items() if not isinstance(value, bool)}
    state = without_feasibility(domain, initial_state(domain) | true) | feasible_atoms(domain, kb)
    if not all(text.strip() for text in goals):
        raise MissionError("--goal is empty; give a condition such as '(found it)', or leave it out")
    # a goal may be several conditions side by side
    texts = [f"(and {text})" for text in goals] if goals else domain.goals
    wanted = [condition for text in texts for condition in conditions(domain, text)]
    engines = mission.engines if mission is not None else ()
    made = Question(domain, kb, state, tuple(wanted), oversights, numbers, engines)
    if mission is None or files or goals:
        return made
    return replace(made, why_not=partial(mission.why_not, kb, Percepts()))


def read_situation(texts: Iterable[str], feasible: Iterable[str] | None = None) -> Supposed:
    """Read what is supposed, such as `battery_level=0.2,camera=failed`.

    Args:
        texts: values of attributes and failed components.
        feasible: names of the ROSA actions that are feasible, several with commas; None for what follows.

    Raises:
        MissionError: it is of another form.
    """
    measured: dict[str, float] = {}
    failed: list[str] = []
    for part in (part for text in texts for part in text.split(",")):
        name, equals, value = (word.strip() for word in part.partition("="))
        if not equals or not name:
            raise MissionError(f"--situation takes ATTRIBUTE=NUMBER or COMPONENT={FAILED}, not {part!r}")
        if value == FAILED:
            failed.append(name)
            continue
        try:
            measured[name] = float(value)
        except ValueError as error:
            message = f"--situation takes {name}=NUMBER, or {name}={FAILED} for a component, not {part.strip()!r}"
            raise MissionError(message) from error
    names = (
        None
        if feasible is None
        else tuple(name.strip() for text in feasible for name in text.split(",") if name.strip())
    )
    return Supposed(names, measured, tuple(failed))


def _check(supposed: Supposed, *, has_model: bool) -> None:
    if not (supposed.measured or supposed.failed):
        return
    if not has_model:
        raise MissionError("a situation is about a model; name its file with --model FILE, or a mission")
    if supposed.feasible is not None:
        raise MissionError("what is feasible follows from the situation; give --feasible or --situation, not both")


def _domain(files: Sequence[Path], mission: Mission | None) -> Domain:
    if mission is not None and not files:
        return mission_domain(mission)
    if len(files) != 2:
        raise MissionError("nothing to plan; give a domain and a problem file, or a mission with --mission NAME")
    return load_domain(*files)


def _told(mission: Mission, kb: KnowledgeBase) -> Mapping[str, bool | float]:
    """Return what a mission knows before it has begun; nothing is sensed, so what is false there may be true."""
    check_facts(mission)
    return mission.facts(kb, Percepts())


def _model(domain: Domain, mission: Mission | None, models: Sequence[Path]) -> Model:
    if models:
        return Model.load(models)
    if mission is not None:
        return mission.model()
    model = Model(domain.name)
    for action in domain.rosa_actions:
        model.action(action)
    return model


def _suppose_feasible(kb: KnowledgeBase, domain: Domain, supposed: Supposed, *, has_model: bool) -> None:
    """Tell the knowledge base what is feasible, if that is given instead of following from a model."""
    if supposed.feasible is not None:
        feasible, reason = _known(domain, supposed.feasible), "it is not among those given as feasible"
    else:
        stated = [atom for atom in initial_state(domain) if domain.is_feasibility(atom)]
        if has_model or not stated:
            return
        feasible = {action for action in domain.rosa_actions if domain.feasible_atom(action) in stated}
        reason = "the problem file does not state that it is feasible"
    for action in domain.rosa_actions:
        if kb.is_feasible(action) != (action in feasible):
            status = "feasible" if action in feasible else "unfeasible"
            kb.assert_status(kb.actions[action], status, reason)


def _known(domain: Domain, names: Iterable[str]) -> set[str]:
    spelled = {action.lower(): action for action in domain.rosa_actions}
    for name in names:
        if name.lower() not in spelled:
            message = f"--feasible names {name!r}, which is no ROSA action of {domain.file}"
            raise MissionError(f"{message}; {nearest(name, domain.rosa_actions)}")
    return {spelled[name.lower()] for name in names}
