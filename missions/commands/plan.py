"""`rosa plan`: a plan on request: what to do in which order, and why actions are unfeasible."""

from pathlib import Path
from typing import Annotated

import typer

from missions.commands import FAILED
from missions.engine.mission import MissionError
from missions.engine.question import Answer, answer, ask, certified
from missions.engine.registry import find_mission
from missions.views.output import as_json, open_files
from missions.views.plan import as_data, causes_of, certificate_as_data, certificate_lines, lines_of, svg_of


def plan(
    files: Annotated[list[Path] | None, typer.Argument(metavar="DOMAIN PROBLEM", help="Two PDDL files.")] = None,
    mission: Annotated[str | None, typer.Option(help="Take domain, problem and model of a mission.")] = None,
    model: Annotated[list[Path] | None, typer.Option(help="File of the model that says what is feasible.")] = None,
    feasible: Annotated[list[str] | None, typer.Option(metavar="A,B", help="Only these actions are feasible.")] = None,
    situation: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME=VALUE", help="Suppose battery_level=0.2, or a component: camera=failed."),
    ] = None,
    goal: Annotated[list[str] | None, typer.Option(help="Reach this, e.g. '(found it)', not the file's goal.")] = None,
    json: Annotated[Path | None, typer.Option(help="Write outcome, engine, cost and steps.")] = None,
    svg: Annotated[Path | None, typer.Option(help="Draw the causal order of the steps.")] = None,
    certificate: Annotated[bool, typer.Option("--certificate", help="Plan for each combination of actions.")] = False,
    failures: Annotated[int | None, typer.Option(help="Certify at most so many failures at once.")] = None,
    timeout: Annotated[float, typer.Option(help="Seconds after which planning is given up.")] = 30.0,
) -> None:
    """Plan, say why actions are out and why there is no plan, and exit with 0 if there is one."""
    if len(files or []) > 2 or (mission and files):
        raise MissionError("give either a domain and a problem file, or a mission with --mission NAME")
    of = find_mission(mission) if mission else None
    question = ask(files or [], of, model or [], situation=situation or [], feasible=feasible, goals=goal or [])
    paths = {"json": json, "svg": svg}
    if certificate and svg:
        raise MissionError("a certificate is many plans, and --svg draws one; leave out one of the two")
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
