"""`rosa verify`: a mission against everything that can happen, before it leaves."""

import signal
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any, Final

import typer

from missions.commands import FAILED, UNFINISHED
from missions.engine.mission import MissionError
from missions.engine.registry import find_mission
from missions.proof.exploration import Exploration
from missions.proof.story import as_test
from missions.proof.verification import prove, setup_of
from missions.views.output import as_json, open_files

_IMPORTS: Final = "from missions.engine.registry import find_mission\nfrom missions.proof.verification import setup_of"


def verify(
    mission: Annotated[str, typer.Argument(help="A mission, or module:NAME.")],
    task: Annotated[str, typer.Option(help="What decides: bt or pddl.")] = "bt",
    failures: Annotated[int, typer.Option(min=0, help="How many components may have failed at once.")] = 1,
    at_once: Annotated[int, typer.Option(help="How many facts may change between two ticks.")] = 1,
    slow: Annotated[bool, typer.Option("--slow", help="The manager may miss its turn.")] = False,
    reaction: Annotated[int, typer.Option(help="Ticks after which nothing unfeasible may be requested.")] = 1,
    exclusive: Annotated[list[str] | None, typer.Option(metavar="A,B", help="Actions that exclude each other.")] = None,
    most: Annotated[int, typer.Option(help="Stop at this number of situations.")] = 100_000,
    seconds: Annotated[float, typer.Option(help="Stop after this time [s].")] = 60.0,
    cores: Annotated[int | None, typer.Option(min=1, help="How many processes explore; default: all cores.")] = None,
    resume: Annotated[Path | None, typer.Option(help="Go on from this file if it exists; write it at the end.")] = None,
    json: Annotated[Path | None, typer.Option(help="Write what was found.")] = None,
    report: Annotated[Path | None, typer.Option(help="Write a page: the first story, or the way to the goal.")] = None,
    test: Annotated[Path | None, typer.Option(help="Write the first story as a test for pytest.")] = None,
) -> None:
    """Say what holds in everything that can happen; exit with 0 if all does, 1 if not, 3 if open: not finished."""
    options: dict[str, Any] = {"failures": failures, "at_once": at_once, "slow": slow}
    setup = setup_of(find_mission(mission), task, **options)
    groups = [[*map(str.strip, one.split(","))] for one in exclusive or ()]
    files = open_files({"json": json, "report": report, "test": test, "resume": resume})

    def explore(found: Exploration) -> None:
        if resume is not None and resume.exists():
            try:
                found.go_on_from(resume.read_bytes())
            except (MissionError, OSError) as error:
                advice = "begin anew with another file, or with none"
                raise MissionError(f"cannot go on from {resume}: {error}; {advice}") from error
        with _interruptible(found):
            found.explore(most, seconds, cores)
        if resume is not None:
            files["resume"].finish(found.as_bytes())

    proof = prove(setup, explore, reaction=reaction, exclusive=groups)
    typer.echo(f"{mission}: {proof}")
    rows = [(" and ".join(one.facts), one.reaches, ", ".join(one.actions)) for one in proof.consequences]
    rows[:0] = [("if for good", "it reaches", "and does meanwhile")] if rows else []
    wide, long = (max((len(row[column]) for row in rows), default=0) for column in (0, 1))
    for facts, reaches, actions in rows:
        typer.echo(f"     {facts:{wide}}  {reaches:{long}}  {actions}".rstrip())
    if "json" in files:
        files["json"].finish(as_json(proof.as_data()))
    if report is not None:
        proof.report(report)
    shown = proof.shown
    if "test" in files and shown is not None and shown.trail is not None:
        made = f"setup_of(find_mission({mission!r}), {task!r}, {', '.join(f'{k}={v}' for k, v in options.items())})"
        files["test"].finish(as_test(f"{_IMPORTS}\n{made}", shown.name, shown.what, shown.trail))
    elif "test" in files:
        why = "no story shows what is broken" if proof.broken else "nothing is broken"
        typer.echo(f"{why}: no test is written")
    if proof.broken:
        raise typer.Exit(FAILED)
    if not proof.found.is_finished:
        fewer = ", or look for fewer failures at once with --failures" if failures else ""
        typer.echo(f"not finished, and nothing is broken so far: raise --seconds or --most, go on with --resume{fewer}")
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
