"""`rosa effort`: the size of models, counted as in the ROSA paper."""

from pathlib import Path
from typing import Annotated

import typer

from missions.experiments.effort import lines_of, survey
from missions.views.output import as_json, open_files


def effort(
    models: Annotated[
        list[str] | None,
        typer.Argument(metavar="MISSION|FILE", help="A mission, module:NAME or model file; default: all missions."),
    ] = None,
    json: Annotated[Path | None, typer.Option(help="Write all that is counted.")] = None,
) -> None:
    """Count what it takes to write a model, beside the counts of the ROSA paper.

    Entities: actions, functions, components, attributes, and each key of each
    configuration. Relations: functional requirements (one for each action),
    function designs, component configurations, constraints (one that is
    shared counts once), estimations.
    """
    files = open_files({"json": json})
    found = survey(models or ())
    typer.echo("\n".join(lines_of(found)))
    if "json" in files:
        files["json"].finish(as_json(found))
