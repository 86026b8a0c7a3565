"""`rosa check`, `rosa plan` and `rosa verify`: judge a model, plan, and prove what holds, before a robot leaves."""

import signal
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, replace
from itertools import groupby
from pathlib import Path
from typing import Annotated, Any, Final

import typer
from py_trees.behaviour import Behaviour
from rich.markup import escape

from kb import KnowledgeBase, Model
from kb.checks import Finding, found, rules
from kb.files import read_text
from missions.commands import FAILED, UNFINISHED, complain, open_console, tree_builder
from missions.engine.mission import Mission, MissionError, Percepts, built, find_mission
from missions.engine.question import Answer, answer, ask, certified
from missions.engine.task_layer import mission_domain
from missions.proof.exploration import Exploration
from missions.proof.verification import as_test, prove, setup_of
from missions.views.output import as_json, open_files
from missions.views.plan import (
    as_data,
    causes_of,
    certificate_as_data,
    certificate_lines,
    lines_of,
    svg_of,
)
from rosa_bt import IsActionFeasible, RosaAction
from rosa_bt.composites import unguarded
from rosa_pddl.domain import ACTION_TYPE, Domain
from rosa_pddl.reader import Node, parse, read_file, section, typed

ACTION_SUFFIX: Final = "_action"
COLOURS = {"error": "red", "warning": "yellow"}
Judged = tuple[str, Sequence[Finding]]
Uses = list[tuple[str, str]]
"""Names of actions, each with the place that uses it; an empty name is one that a tree gets only when it runs."""
_IMPORTS: Final = "from missions.engine.mission import find_mission\nfrom missions.proof.verification import setup_of"
"""The first lines of a test that `rosa verify --test` writes."""


def check(
    files: Annotated[
        list[Path] | None, typer.Argument(help="Files of a model, each may add to those before.")
    ] = None,
    mission: Annotated[
        str | None, typer.Option(help="Check with its tree and PDDL, or its own model.")
    ] = None,
    tree: Annotated[
        list[str] | None, typer.Option(metavar="MODULE:CALLABLE", help="A tree that uses it.")
    ] = None,
    pddl: Annotated[
        list[Path] | None, typer.Option(help="A PDDL domain or problem that uses it.")
    ] = None,
    strict: Annotated[bool, typer.Option("--strict", help="Exit with 1 for warnings too.")] = False,
    json: Annotated[bool, typer.Option("--json", help="Print the findings as JSON.")] = False,
    reason: Annotated[
        bool, typer.Option("--reason", help="Have HermiT look for contradictions; needs Java.")
    ] = False,
) -> None:
    """Judge a model, say what to do about each finding, and exit with 0 if nothing in it can never work."""
    of = find_mission(mission) if mission else None
    model, findings = judge(files or [], of, tree or [], pddl or [])
    contradictions = list(_contradictions(files or [], of)) if reason else []
    for one in contradictions:
        complain(one)
    if json:
        counts = {f"{severity}s": len(_of(severity, findings)) for severity in COLOURS}
        shown = {"model": model, **counts, "findings": [asdict(one) for one in findings]}
        typer.echo(as_json(shown), nl=False)
    else:
        _print(model, findings)
        if reason and not contradictions:
            typer.echo("HermiT finds no contradiction")
    if _of("error", findings) or contradictions or (strict and findings):
        raise typer.Exit(FAILED)


def judge(
    files: Sequence[Path], mission: Mission | None, trees: Sequence[str], pddl: Sequence[Path]
) -> Judged:
    """Return the name and findings of a model, from files or else of the mission, and of what uses it.

    Trees are given as module:callable.

    Raises:
        MissionError, KnowledgeBaseError, RosaPddlError: something cannot be read or built; the message says where.
    """
    model = model_of(files, mission)
    if not (trees or pddl or mission):
        return model.name, model.check()
    built = [(tree_builder(tree), f"tree {tree}") for tree in trees]
    built += (
        []
        if mission is None or mission.tree is None
        else [(mission.tree, f"the tree of {mission.name}")]
    )
    used = [names_in_tree(tree, model, title) for tree, title in built]
    uses = [one for of_tree, _ in used for one in of_tree]
    uses += names_in_pddl(pddl) if pddl else []
    uses += [] if mission is None else planned_names(mission)
    unguarded = [
        found(
            "unguarded-action",
            f"action {name}",
            f"{place} goes on with {name} when that is unfeasible",
        )
        for _, careless in used
        for name, place in careless
    ]
    places: dict[str, list[str]] = {}
    for name, place in uses:
        places.setdefault(name, []).append(place)
    is_complete = "" not in places  # a tree may get any action later
    places.pop("", None)
    findings = [*_placed(model.check(places), places, is_complete), *unguarded]
    return model.name, (
        *findings,
        *(() if mission is None else _oversights(mission, model, findings)),
    )


def _oversights(mission: Mission, model: Model, findings: Sequence[Finding]) -> Iterator[Finding]:
    """Yield what planning for a mission would ignore without a word, unless another finding says it."""
    said = [
        f" {one.element.removeprefix('action ')!r} "
        for one in findings
        if one.code == "unmentioned-action"
    ]
    if mission.problem is not None and not any(one.code == "unknown-action" for one in findings):
        for note in mission_domain(mission).check(KnowledgeBase(model)):
            if not any(name in note for name in said):
                yield found("file-note", f"mission {mission.name}", note)


def model_of(files: Sequence[Path], mission: Mission | None) -> Model:
    if files:
        return Model.load(files)
    if mission is None:
        raise MissionError("no model is named; name its files, or a mission with --mission NAME")
    return mission.model()


def _placed(
    findings: Iterable[Finding], places: Mapping[str, Sequence[str]], is_complete: bool
) -> Iterator[Finding]:
    for one in findings:
        if one.code == "unknown-action":
            first, *others = places[one.element]
            more = f" and {len(others)} more" if others else ""
            yield replace(one, place=f"{first}{more}")
        elif one.code != "unmentioned-action" or is_complete:
            yield one


def _contradictions(files: Sequence[Path], mission: Mission | None) -> Iterator[str]:
    """Yield the contradictions that an OWL reasoner finds: in OWL files as they are, in other models as OWL."""
    from kb.ontology import contradiction, owl_text

    model = model_of(files, mission)
    texts = {str(file): read_text(file) for file in files if file.suffix.lower() == ".owl"}
    for where, text in (texts or {model.name: owl_text(model)}).items():
        what = contradiction(text)
        if what:
            yield f"{where}: {what}"


def _of(severity: str, findings: Iterable[Finding]) -> list[Finding]:
    """Return the findings of a severity, "error" or "warning"."""
    return [one for one in findings if one.severity == severity]


def _print(model: str, findings: Iterable[Finding]) -> None:
    console = open_console()
    for severity, colour in COLOURS.items():
        sorted_by_rule = sorted(
            _of(severity, findings), key=lambda one: list(rules()).index(one.code)
        )
        for code, group in groupby(sorted_by_rule, key=lambda one: one.code):
            console.print(f"[bold {colour}]{severity}[/] {code}")
            for one in group:
                console.print(f"  {escape(one.where_and_what)}", soft_wrap=True)
            console.print(f"  -> {escape(rules()[code].advice)}", soft_wrap=True)
    counts = [(len(_of(severity, findings)), severity) for severity in COLOURS]
    shown = [f"{count} {severity}{'s' if count > 1 else ''}" for count, severity in counts if count]
    console.print(f"model {escape(model)}: {' and '.join(shown) or 'nothing found'}")


class _Tolerant(KnowledgeBase):
    """A knowledge base that lets trees ask for unknown actions, so that they can be built and judged."""

    def is_feasible(self, action: str) -> bool:
        return True


def names_in_tree(build: Callable[..., object], model: Model, title: str) -> tuple[Uses, Uses]:
    """Return the actions that a tree uses, and those that it goes on with when they become unfeasible.

    `build` is called with a knowledge base and percepts, or as many of them as it takes.
    """
    root = built(title, Behaviour, build, _Tolerant(model), Percepts())  # type: ignore[type-abstract]  # only asked about
    asking = [one for one in root.iterate() if isinstance(one, IsActionFeasible | RosaAction)]
    uses, careless = (
        [(_action(one), f"behaviour {one.name!r} of {title}") for one in some]
        for some in (asking, unguarded(root))
    )
    return uses, careless


def _action(behaviour: IsActionFeasible | RosaAction) -> str:
    try:
        return behaviour.action
    except (
        Exception
    ):  # py_trees raises several kinds when a port is not connected before the tree runs
        return ""


def names_in_pddl(paths: Iterable[Path]) -> Uses:
    """Return the actions that PDDL files use: the constants and objects of type action or a subtype.

    If there are none, each predicate `(NAME_action ?a)` with one parameter of type action stands for the action NAME.
    """
    sources = [parse(read_file(path), str(path)) for path in paths]
    parents = {
        name.lower: of for source in sources for name, of in _declared(section(source, ":types"))
    }
    found = [
        (str(name), _place(name))
        for source in sources
        for name, of in _declared(section(source, ":constants") + section(source, ":objects"))
        if _is_action(of, parents)
    ]
    return found or [use for source in sources for use in _by_predicate(source, parents)]


def planned_names(mission: Mission) -> Uses:
    """Return the ROSA actions that the planned task layer of a mission uses."""
    if mission.domain is None or mission.problem is None:
        return []
    domain = mission_domain(mission)
    return [(name, _declared_at(domain, name)) for name in domain.rosa_actions]


def _declared_at(domain: Domain, name: str) -> str:
    file, line = domain.places.get(("object", name), (domain.file, 0))
    return f"{file}:{line}" if line else file


def _by_predicate(source: Node, parents: Mapping[str, str]) -> Iterator[tuple[str, str]]:
    for predicate in section(source, ":predicates"):
        name = predicate.children[0]
        types = [of for _, of in _declared(predicate.children[1:])]
        if name.lower.endswith(ACTION_SUFFIX) and len(types) == 1 and _is_action(types[0], parents):
            yield str(name)[: -len(ACTION_SUFFIX)], _place(name)


def _declared(nodes: Iterable[Node]) -> list[tuple[Node, str]]:
    """Return the names in a list of declarations with their types in lower case; the default is object."""
    return [(name, "object" if of is None else of.lower) for name, of in typed(nodes)]


def _is_action(name: str, parents: Mapping[str, str]) -> bool:
    seen: set[str] = set()
    while name != ACTION_TYPE and name in parents and name not in seen:
        seen.add(name)
        name = parents[name]
    return name == ACTION_TYPE


def _place(node: Node) -> str:
    return f"{node.file}:{node.line}:{node.column}"


# -------------------------------------------------------------------- a plan on request


def plan(
    files: Annotated[
        list[Path] | None, typer.Argument(metavar="DOMAIN PROBLEM", help="Two PDDL files.")
    ] = None,
    mission: Annotated[
        str | None, typer.Option(help="Take domain, problem and model of a mission.")
    ] = None,
    model: Annotated[
        list[Path] | None, typer.Option(help="File of the model that says what is feasible.")
    ] = None,
    feasible: Annotated[
        list[str] | None, typer.Option(metavar="A,B", help="Only these actions are feasible.")
    ] = None,
    situation: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME=VALUE", help="Suppose battery_level=0.2, or a component: camera=failed."
        ),
    ] = None,
    goal: Annotated[
        list[str] | None, typer.Option(help="Reach this, e.g. '(found it)', not the file's goal.")
    ] = None,
    json: Annotated[
        Path | None, typer.Option(help="Write outcome, engine, cost and steps.")
    ] = None,
    svg: Annotated[Path | None, typer.Option(help="Draw the causal order of the steps.")] = None,
    certificate: Annotated[
        bool, typer.Option("--certificate", help="Plan for each combination of actions.")
    ] = False,
    failures: Annotated[
        int | None, typer.Option(help="Certify at most so many failures at once.")
    ] = None,
    timeout: Annotated[
        float, typer.Option(help="Seconds after which planning is given up.")
    ] = 30.0,
) -> None:
    """Plan, say why actions are out and why there is no plan, and exit with 0 if there is one."""
    if len(files or []) > 2 or (mission and files):
        raise MissionError(
            "give either a domain and a problem file, or a mission with --mission NAME"
        )
    of = find_mission(mission) if mission else None
    question = ask(
        files or [], of, model or [], situation=situation or [], feasible=feasible, goals=goal or []
    )
    paths = {"json": json, "svg": svg}
    if certificate and svg:
        raise MissionError(
            "a certificate is many plans, and --svg draws one; leave out one of the two"
        )
    if failures is not None and not certificate:
        raise MissionError("--failures says how much to certify; add --certificate")
    outputs = open_files(paths)
    if certificate:
        proven = certified(question, timeout, failures)
        for line in certificate_lines(proven):
            typer.echo(line)
        for output in outputs.values():
            output.finish(as_json(certificate_as_data(proven)))
        raise typer.Exit(0 if proven.entries[()].outcome.is_solved else FAILED)
    found = answer(question, timeout)
    for line in lines_of(found):
        typer.echo(line)
    is_solved = found.result.outcome.is_solved
    for name, output in outputs.items():
        if is_solved or name == "json":
            output.finish(_written(name, found))
        else:
            typer.echo(f"{paths[name]} is not written, as there is no plan")
    if not is_solved:
        raise typer.Exit(FAILED)


def _written(option: str, found: Answer) -> str:
    if option == "svg":
        return svg_of(causes_of(found), f"plan of {found.question.domain.name}")
    return as_json(as_data(found.result))


# -------------------------------------------------------------------- everything that can happen


def verify(
    mission: Annotated[str, typer.Argument(help="A mission, or module:NAME.")],
    failures: Annotated[
        int, typer.Option(min=0, help="How many components may have failed at once.")
    ] = 1,
    at_once: Annotated[int, typer.Option(help="How many facts may change between two ticks.")] = 1,
    slow: Annotated[bool, typer.Option("--slow", help="The manager may miss its turn.")] = False,
    reaction: Annotated[
        int, typer.Option(help="Ticks after which nothing unfeasible may be requested.")
    ] = 1,
    exclusive: Annotated[
        list[str] | None, typer.Option(metavar="A,B", help="Actions that exclude each other.")
    ] = None,
    suggest: Annotated[
        bool, typer.Option("--suggest", help="Look for what mends a broken tree.")
    ] = False,
    most: Annotated[int, typer.Option(help="Stop at this number of situations.")] = 100_000,
    seconds: Annotated[float, typer.Option(help="Stop after this time [s].")] = 60.0,
    json: Annotated[Path | None, typer.Option(help="Write what was found.")] = None,
    report: Annotated[
        Path | None, typer.Option(help="Write a page: the first story, or the way to the goal.")
    ] = None,
    test: Annotated[
        Path | None, typer.Option(help="Write the first story as a test for pytest.")
    ] = None,
) -> None:
    """Verify a mission's tree. Exit 0: all properties hold; 1: one is violated; 3: not finished."""
    options: dict[str, Any] = {"failures": failures, "at_once": at_once, "slow": slow}
    setup = setup_of(find_mission(mission), **options)
    groups = [[*map(str.strip, group.split(","))] for group in exclusive or ()]
    files = open_files({"json": json, "report": report, "test": test})

    def explore(explored: Exploration) -> None:
        with _interruptible(explored):
            explored.explore(most, seconds)

    proof = prove(setup, explore, reaction=reaction, exclusive=groups, suggest=suggest)
    typer.echo(f"{mission}: {proof}")
    rows = [
        (" and ".join(each.facts), each.reaches, ", ".join(each.actions))
        for each in proof.consequences
    ]
    rows[:0] = [("if for good", "it reaches", "and does meanwhile")] if rows else []
    wide, long = (max((len(row[column]) for row in rows), default=0) for column in (0, 1))
    for facts, reaches, actions in rows:
        typer.echo(f"     {facts:{wide}}  {reaches:{long}}  {actions}".rstrip())
    if "json" in files:
        files["json"].finish(as_json(proof.as_data()))
    if report is not None:
        proof.report(report)
    shown = proof.shown
    if "test" in files and shown is not None:
        arguments = ", ".join(f"{name}={value}" for name, value in options.items())
        made = f"setup_of(find_mission({mission!r}), {arguments})"
        files["test"].finish(as_test(f"{_IMPORTS}\n{made}", shown))
    elif "test" in files:
        why = "no story shows what is broken" if proof.broken else "nothing is broken"
        typer.echo(f"{why}: no test is written")
    if proof.broken:
        raise typer.Exit(FAILED)
    if not proof.explored.is_finished:
        fewer = ", or look for fewer failures at once with --failures" if failures else ""
        typer.echo(f"not finished, and nothing is broken so far: raise --seconds or --most{fewer}")
        raise typer.Exit(UNFINISHED)


@contextmanager
def _interruptible(found: Exploration) -> Iterator[None]:
    """Let Ctrl-C end the exploration, so that what was found is shown and kept; a second one ends the program."""

    def stop(*_: object) -> None:
        found.stop()
        signal.signal(signal.SIGINT, before)

    before = signal.signal(signal.SIGINT, stop)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)
