"""`rosa check`: judge a model together with the trees and PDDL files that use it."""

from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, replace
from itertools import groupby
from pathlib import Path
from typing import Annotated, Final

from py_trees.behaviour import Behaviour
from rich.markup import escape
from typer import Argument, Exit, Option, echo

from kb import KnowledgeBase, Model
from kb.checks import Finding, finding_of, listing, rules
from kb.files import read_text
from missions import SUMMARIES
from missions.commands import FAILED, Text, Texts, complain, open_console, tree_builder
from missions.engine.mission import Mission, MissionError, Percepts, built, find_mission
from missions.engine.task_layer import mission_domain
from missions.views.output import as_json
from rosa_bt import IsActionFeasible, RosaAction
from rosa_pddl import load_domain
from rosa_pddl.domain import Domain, conjuncts
from rosa_pddl.executor import check_behaviours

COLOURS: Final = {"error": "red", "warning": "yellow"}
_UNKNOWN: Final = "unknown-action"
_UNMENTIONED: Final = "unmentioned-action"


def check(
    files: Annotated[
        list[Path] | None, Argument(help="Files of a model, each may add to those before.")
    ] = None,
    mission: Annotated[Text, Option(help="Check with its tree and PDDL, or its own model.")] = None,
    tree: Annotated[Texts, Option(metavar="MODULE:CALLABLE", help="A tree that uses it.")] = None,
    pddl: Annotated[
        list[Path] | None, Option(help="A PDDL domain that uses it; again: its problem.")
    ] = None,
    strict: Annotated[bool, Option("--strict", help="Exit with 1 for warnings too.")] = False,
    json: Annotated[bool, Option("--json", help="Print the findings as JSON.")] = False,
    reason: Annotated[
        bool, Option("--reason", help="Let HermiT look for contradictions; needs Java.")
    ] = False,
) -> None:
    """Judge a model, say what to do about each finding, and exit with 0 if there is no error."""
    named = find_mission(mission) if mission else None
    model = _model_of(files or [], named)
    findings = judge(model, named, tree or [], pddl or [])
    contradictions = list(_contradictions(files or [], model)) if reason else []
    for contradiction in contradictions:
        complain(contradiction)
    by_severity = {
        severity: [finding for finding in findings if finding.severity == severity]
        for severity in COLOURS
    }
    if json:
        counts = {f"{severity}s": len(some) for severity, some in by_severity.items()}
        shown = {"model": model.name, **counts, "findings": list(map(asdict, findings))}
        echo(as_json(shown), nl=False)
    else:
        _print(model.name, by_severity)
        if reason and not contradictions:
            echo("HermiT finds no contradiction")
    if by_severity["error"] or contradictions or (strict and findings):
        raise Exit(FAILED)


def judge(
    model: Model, mission: Mission | None, trees: Sequence[str], pddl: Sequence[Path]
) -> Sequence[Finding]:
    """Return the findings of a model and of what uses it.

    Args:
        model: the model.
        mission: its tree and its domain use the model.
        trees: given as module:callable.
        pddl: a domain, or a domain and its problem.

    Raises:
        MissionError, KnowledgeBaseError, RosaPddlError: something cannot be read or built; the
            message says where.
    """
    if not (trees or pddl or mission):
        return model.check()
    builders = {f"tree {tree}": tree_builder(tree) for tree in trees}
    if len(pddl) > 2:
        raise MissionError("give --pddl for a domain, and once more for its problem")
    domains = [load_domain(*pddl)] if pddl else []
    if mission is not None and mission.tree is not None:
        builders[f"the tree of {mission.name}"] = mission.tree
    planned = None
    if mission is not None and mission.domain is not None and mission.problem is not None:
        planned = mission_domain(mission)
        domains.append(planned)
    places = defaultdict[str, list[str]](list)
    findings: list[Finding] = []
    for title, build in builders.items():
        _judge_tree(title, build, model, places)
    for domain in domains:
        for name in domain.rosa_actions:
            places[name].append(_place(domain, name))
    findings += [finding for domain in domains for finding in _promised_twice(domain, model)]
    is_complete = places.pop("", None) is None  # a tree may get any action later
    of_model = list(_placed(model.check(places), places, is_complete))
    codes = {finding.code for finding in of_model}
    if mission is not None and planned is not None and _UNKNOWN not in codes:
        check_behaviours(planned, mission.actions)
        unmentioned = [f.element for f in of_model if f.code == _UNMENTIONED]
        names = [repr(element.removeprefix("action ")) for element in unmentioned]
        for note in planned.check(KnowledgeBase(model)):
            if not any(name in note for name in names):  # else another finding says it
                findings.append(finding_of("file-note", f"mission {mission.name}", note))
    return [*of_model, *findings]


def _promised_twice(domain: Domain, model: Model) -> Iterator[Finding]:
    """Yield the actions that several others make feasible, if the model does not say what of."""
    effects = [effect for schema in domain.schema_of.values() for effect in schema.effects]
    changed = {effect.name for effect in effects}
    promises = defaultdict[str, dict[str, bool]](dict)
    for schema in domain.schema_of.values():
        curing = [name for name in model.actions if domain.may_do(schema, name)]
        if len(curing) == len(model.actions):
            curing = []  # nothing says which ones do it
        says = {name: bool(model.actions[name].restores) for name in curing}
        for effect in schema.effects:
            if effect.kind != "add" or not domain.is_feasibility(f"({effect.name})"):
                continue
            (term,) = effect.terms
            needed = [part[1] for part in conjuncts(schema.conditions) if part[2:] == ((term,),)]
            kinds = set(needed) - changed  # what kind of action it is, such as `scan_action`
            for action in domain.rosa_actions if term.startswith("?") else [term]:
                if all(f"({kind} {action})" in domain.facts for kind in kinds):
                    promises[action] |= says or {schema.name: False}
    for action, says in promises.items():
        silent = [name for name, is_said in says.items() if not is_said]
        if len(says) > 1 and silent:
            message = f"action {action} is made feasible by {listing(says)}"
            unsaid = f"the model does not say what {listing(silent)} can restore"
            yield finding_of("restored-twice", f"action {action}", f"{message}; {unsaid}")


class _Tolerant(KnowledgeBase):
    """Lets trees ask for unknown actions, so that they can be built and judged."""

    def is_feasible(self, action: str) -> bool:
        return True


def _judge_tree(
    title: str, build: Callable[..., object], model: Model, places: Mapping[str, list[str]]
) -> None:
    """Note where a tree uses actions."""
    root = built(title, Behaviour, build, _Tolerant(model), Percepts())  # type: ignore[type-abstract]  # only asked about
    for node in root.iterate():
        if isinstance(node, IsActionFeasible | RosaAction):
            places[_action(node)].append(f"behaviour {node.name!r} of {title}")


def _action(behaviour: IsActionFeasible | RosaAction) -> str:
    """Return the name of an action; empty if a tree gets it only when it runs."""
    try:
        return behaviour.action
    except Exception:  # py_trees raises several kinds when a port is not connected yet
        return ""


def _place(domain: Domain, name: str) -> str:
    file, line = domain.places.get(name, (domain.file, 0))
    return f"{file}:{line}" if line else file


def _model_of(files: Sequence[Path], mission: Mission | None) -> Model:
    for file in files:
        if str(file) in SUMMARIES:
            raise MissionError(f"{file} is a mission; check it with --mission {file}")
    if files:
        return Model.load(files)
    if mission is None:
        raise MissionError("no model is named; name its files, or a mission with --mission NAME")
    return mission.model()


def _placed(
    findings: Iterable[Finding], places: Mapping[str, Sequence[str]], is_complete: bool
) -> Iterator[Finding]:
    """Yield findings with their places; actions are unmentioned only if all names are known."""
    for finding in findings:
        if finding.code == _UNKNOWN:
            yield replace(finding, place=places[finding.element][0])
        elif finding.code != _UNMENTIONED or is_complete:
            yield finding


def _contradictions(files: Sequence[Path], model: Model) -> Iterator[str]:
    """Yield what an OWL reasoner finds in OWL files as they are, and in other models as OWL."""
    from kb.ontology import contradiction, owl_text

    texts = {str(file): read_text(file) for file in files if file.suffix.lower() == ".owl"}
    for place, text in (texts or {model.name: owl_text(model)}).items():
        problem = contradiction(text)
        if problem:
            yield f"{place}: {problem}"


def _print(model: str, by_severity: Mapping[str, Sequence[Finding]]) -> None:
    console = open_console()
    order = list(rules())
    counts = []
    for severity, findings in by_severity.items():
        if findings:
            counts.append(f"{len(findings)} {severity}{'s' if len(findings) > 1 else ''}")
        in_order = sorted(findings, key=lambda finding: order.index(finding.code))
        for code, group in groupby(in_order, key=lambda finding: finding.code):
            console.print(f"[bold {COLOURS[severity]}]{severity}[/] {code}")
            for finding in group:
                console.print(f"  {escape(finding.where_and_what)}", soft_wrap=True)
            console.print(f"  -> {escape(rules()[code].advice)}", soft_wrap=True)
    console.print(f"model {escape(model)}: {' and '.join(counts) or 'nothing found'}")
