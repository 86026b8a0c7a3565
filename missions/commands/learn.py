"""`rosa learn`: suggestions for a model from runs; it changes nothing unless asked to."""

from pathlib import Path
from typing import Annotated

import typer

from missions.commands import ROBOT, open_console
from missions.engine.mission import MissionError
from missions.engine.registry import find_robot
from missions.experiments.learning import learn as suggestions_of
from missions.experiments.learning import read_runs

KINDS = ("rate", "estimation", "threshold")


def learn(
    runs: Annotated[list[Path], typer.Argument(help="Recordings, and folders of campaigns.")],
    model: Annotated[str, typer.Option(help=ROBOT)],
    apply: Annotated[Path | None, typer.Option(metavar="FILE", help="Write the changed model here.")] = None,
    take: Annotated[
        list[str] | None,
        typer.Option(metavar="KIND", help="What to change: rate, estimation (both by default), threshold."),
    ] = None,
) -> None:
    """Suggest changes of a model, each with its interval and the number of observations; --apply writes them."""
    taken = take or ["rate", "estimation"]
    for kind in taken:
        if kind not in KINDS:
            raise MissionError(f"--take is {kind!r}; what can be changed is {', '.join(KINDS)}")
    if apply is not None and apply.exists():
        raise MissionError(f"{apply} is there already; name a file that is not")
    known, mission = find_robot(model)
    console = open_console()
    changed = 0
    for one in suggestions_of(read_runs(runs), known, mission):
        console.print(str(one), markup=False)
        if apply is not None and one.apply is not None and one.kind in taken:
            one.apply()
            changed += 1
    if apply is not None:
        known.save(apply)
        console.print(f"{changed} change{'s' * (changed != 1)}, written to {apply}", markup=False)
