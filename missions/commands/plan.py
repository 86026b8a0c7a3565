"""`rosa plan` and `rosa verify`: plan on request, and prove what a tree does."""

from pathlib import Path
from typing import Annotated

from typer import Argument, Exit, Option, echo

from missions.commands import FAILED, UNFINISHED, File, Text, Texts
from missions.engine.mission import MissionError, find_mission
from missions.engine.question import answer, ask, certified
from missions.proof.setup import setup_of
from missions.proof.verification import prove
from missions.views.output import as_json, open_files
from missions.views.plan import (
    as_data,
    certificate_as_data,
    certificate_lines,
    lines_of,
    links_of,
    svg_of,
)


def plan(
    files: Annotated[
        list[Path] | None, Argument(metavar="DOMAIN PROBLEM", help="Two PDDL files.")
    ] = None,
    mission: Annotated[Text, Option(help="Take domain, problem and model of a mission.")] = None,
    model: Annotated[
        list[Path] | None, Option(help="File of the model that says what is feasible.")
    ] = None,
    situation: Annotated[
        Texts,
        Option(metavar="NAME=VALUE", help="Suppose battery_level=0.2, or camera=failed."),
    ] = None,
    goal: Annotated[
        Texts, Option(help="Reach this, e.g. '(found it)', not the file's goal.")
    ] = None,
    json: Annotated[File, Option(help="Write outcome, engine, cost and steps.")] = None,
    svg: Annotated[File, Option(help="Draw the causal order of the steps.")] = None,
    certificate: Annotated[
        bool, Option("--certificate", help="Plan for each combination of actions.")
    ] = False,
    failures: Annotated[
        int | None, Option(min=0, help="Certify at most so many failures at once.")
    ] = None,
    engine: Annotated[
        Text, Option(help="Plan with fast-downward-opt, fast-downward, kairos or another engine.")
    ] = None,
    timeout: Annotated[float, Option(help="Seconds after which planning is given up.")] = 30.0,
) -> None:
    """Plan, say why actions are out or why there is no plan, and exit with 0 if there is one."""
    named = find_mission(mission) if mission else None
    paths = files or []
    if len(paths) != (0 if named else 2):
        given = [*map(str, paths), *filter(None, [mission])]
        advice = "give a domain and a problem file, or a mission with --mission NAME"
        raise MissionError(f"{advice}, not {', '.join(given) or 'nothing'}")
    if certificate and svg:
        raise MissionError("a certificate is many plans, and --svg draws one; leave out one")
    if failures is not None and not certificate:
        raise MissionError("--failures says how much to certify; add --certificate")
    question = ask(
        paths,
        named,
        model or [],
        situation=situation or [],
        goals=goal or [],
        engine=engine,
    )
    outputs = open_files({"json": json, "svg": svg})
    if certificate:
        proven = certified(question, timeout, failures)
        lines = certificate_lines(proven)
        is_solved = proven.entries[()].outcome.is_solved
        texts = {"json": as_json(certificate_as_data(proven))}
    else:
        reply = answer(question, timeout)
        lines = lines_of(reply)
        is_solved = reply.result.outcome.is_solved
        texts = {"json": as_json(as_data(reply.result))}
        if is_solved and svg:
            title = f"plan of {question.domain.name}"
            texts["svg"] = svg_of(reply.result.steps, links_of(reply), title)
    for line in lines:
        echo(line)
    for name, output in outputs.items():
        if name in texts:
            output.finish(texts[name])
        else:
            echo(f"{svg} is not written, as there is no plan")
    if not is_solved:
        raise Exit(FAILED)


def verify(
    mission: Annotated[str, Argument(help="A mission, or module:NAME.")],
    failures: Annotated[
        int, Option(min=0, help="How many components may have failed at once.")
    ] = 1,
    suggest: Annotated[
        bool, Option("--suggest", help="Look for what mends a broken tree.")
    ] = False,
    seconds: Annotated[float, Option(help="Stop after this time [s].")] = 60.0,
    json: Annotated[File, Option(help="Write what was found.")] = None,
    report: Annotated[
        File, Option(help="Write a page: the first story, or the way to the goal.")
    ] = None,
) -> None:
    """Verify a mission's tree. Exit 0: all properties hold; 1: one is violated; 3: not finished."""
    setup = setup_of(find_mission(mission), failures=failures, seconds=seconds)
    files = open_files({"json": json, "report": report})
    proof = prove(setup, suggest=suggest)
    echo(f"{mission}: {proof}")
    rows = [("if for good", "it reaches", "and does meanwhile")]
    for each in proof.consequences:
        rows.append((each.fact, each.reaches, ", ".join(each.actions)))
    if len(rows) > 1:
        wide = max(len(facts) for facts, _, _ in rows)
        long = max(len(reaches) for _, reaches, _ in rows)
        for facts, reaches, actions in rows:
            echo(f"     {facts:{wide}}  {reaches:{long}}  {actions}".rstrip())
    if "json" in files:
        files["json"].finish(as_json(proof.as_data()))
    if report is not None:
        proof.report(report)
    if proof.broken:
        raise Exit(FAILED)
    if proof.explored.unexplored:
        fewer = ", or look for fewer failures at once with --failures" if failures else ""
        echo(f"not finished, and nothing is broken so far: raise --seconds{fewer}")
        raise Exit(UNFINISHED)
