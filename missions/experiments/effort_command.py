"""`rosa effort`: how large models are by the ROSA paper's way of counting, and what their authors write."""

from contextlib import ExitStack
from pathlib import Path
from typing import Annotated

import typer

from missions.output import open_files
from missions.report import as_json

__all__ = ["effort"]


def effort(
    models: Annotated[
        list[str] | None,
        typer.Argument(metavar="MISSION|FILE", help="A mission, module:NAME or model file; default: all missions."),
    ] = None,
    json_file: Annotated[Path | None, typer.Option("--json", help="Write all that is counted.")] = None,
    plot: Annotated[Path | None, typer.Option(help="Draw the counts and the linear law: *.svg, else PNG.")] = None,
) -> None:
    """Count what it takes to write a model, beside the counts of the ROSA paper.

    Entities: actions, functions, components, attributes, and each key of each
    configuration. Relations: functional requirements (one for each action),
    function designs, component configurations, constraints (one that is
    shared counts once), estimations.

    Of Python and TypeQL, statements and lines are counted: no docstrings,
    imports, comments and blank lines.
    """
    from missions.experiments.effort import as_data, survey
    from missions.experiments.effort_views import print_survey

    wanted = {"json": json_file, "plot": plot}
    with ExitStack() as stack:
        files = open_files({name: path for name, path in wanted.items() if path is not None}, stack)
        found = survey(models or ())
        print_survey(found)
        if "json" in files:
            files["json"].write(as_json(as_data(found)))
            files["json"].keep()
        if plot is not None:
            from missions.experiments.effort_views import draw

            files["plot"].write(draw(found, "svg" if plot.suffix.lower() == ".svg" else "png"))
            files["plot"].keep()
