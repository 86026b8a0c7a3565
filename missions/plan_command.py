"""`rosa plan`: a plan asked for by hand: what to do in which order, why actions are out, and a tree that does it."""

import json
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer

from missions.engine.mission import MissionError
from missions.engine.registry import find_mission
from missions.output import open_files
from missions.planning.answer import Answer, answer
from missions.planning.picture import svg_of_plan
from missions.planning.question import ask, read_situation

__all__ = ["plan"]

FAILED = 1


def plan(
    files: Annotated[list[Path] | None, typer.Argument(metavar="DOMAIN PROBLEM", help="Two PDDL files.")] = None,
    mission: Annotated[str | None, typer.Option(help="Take domain, problem and model of a mission.")] = None,
    model: Annotated[list[Path] | None, typer.Option(help="File of the model that says what is feasible.")] = None,
    feasible: Annotated[
        list[str] | None, typer.Option(metavar="A,B", help="Just these ROSA actions are feasible.")
    ] = None,
    situation: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME=VALUE", help="Suppose battery_level=0.2, or a component: camera=failed."),
    ] = None,
    goal: Annotated[list[str] | None, typer.Option(help="Reach this, e.g. '(found it)', not the file's goal.")] = None,
    json_file: Annotated[Path | None, typer.Option("--json", help="Write outcome, engine, cost and steps.")] = None,
    svg: Annotated[Path | None, typer.Option(help="Draw the causal order of the steps.")] = None,
    tree: Annotated[
        Path | None, typer.Option(help="Write the plan as a tree: BehaviorTree.CPP's XML to *.xml, else text.")
    ] = None,
    timeout: Annotated[float, typer.Option(help="Seconds after which planning is given up.")] = 30.0,
) -> None:
    """Plan, say why actions are out and why there is no plan, and exit with 0 if there is one."""
    if len(files or []) > 2 or (mission and files):
        raise MissionError("give either a domain and a problem file, or a mission with --mission NAME")
    supposed = read_situation(situation or [])
    if feasible is not None:
        supposed = replace(supposed, feasible=tuple(name for text in feasible for name in _names(text)))
    question = ask(files or [], find_mission(mission) if mission else None, model or [], supposed, goal or [])
    wanted = {"json": json_file, "svg": svg, "tree": tree}
    with ExitStack() as stack:
        outputs = open_files({name: path for name, path in wanted.items() if path is not None}, stack)
        found = answer(question, timeout)
        for line in found.lines():
            typer.echo(line)
        is_solved = found.result.outcome.is_solved
        for name, output in outputs.items():
            if is_solved or name == "json":
                output.write(_text(name, found, wanted[name]))
                output.keep()
            else:
                typer.echo(f"{wanted[name]} is not written, as there is no plan")
    if not is_solved:
        raise typer.Exit(FAILED)


def _text(name: str, found: Answer, path: Path | None) -> str:
    """Return what is written for an option."""
    if name == "json":
        return json.dumps(found.data, indent=2) + "\n"
    if name == "svg":
        return svg_of_plan(found.order, f"plan of {found.question.domain.name}")
    return found.tree(xml=path is not None and path.suffix.lower() == ".xml")


def _names(text: str) -> list[str]:
    return [name.strip() for name in text.split(",") if name.strip()]
