"""`rosa report`: the report on a campaign, or a page of one or two runs to click through."""

from pathlib import Path
from typing import Annotated

import typer

from missions.engine.mission import MissionError
from missions.engine.registry import needs
from missions.experiments.results import read_store
from missions.views import report as page


def report(
    sources: Annotated[
        list[Path],
        typer.Argument(metavar="DIR | RECORDING [RECORDING]", help="A campaign's folder, or one or two runs."),
    ],
    out: Annotated[
        Path | None,
        typer.Option("--out", "-o", help="Where to write; default: DIR/report, or the recording's name with .html."),
    ] = None,
    pages: Annotated[bool, typer.Option("--pages", help="Of a campaign: a page of each run that stands out.")] = False,
    figures: Annotated[list[str] | None, typer.Option("--figure", help="Of a campaign: compare by these.")] = None,
) -> None:
    """Say what came of a campaign, as report.md and report.html; or show a run, or two side by side, as a page.

    A run is a recording, or a page that `rosa run MISSION --report FILE.html` wrote.
    """
    if len(sources) > 2:
        raise MissionError(f"one run is shown, or two beside each other, not {len(sources)}")
    if len(sources) == 1 and not sources[0].is_file() and sources[0].suffix not in (".html", ".mcap"):
        kept = read_store(sources[0])
        with needs("plot", "the report on a campaign"):
            import matplotlib  # noqa: F401  # it is found out before anything is written
            import scipy  # noqa: F401  # found out before anything is written
        from missions.experiments.report import write_report as write_campaign  # draws: only if there is something

        for path in write_campaign(kept, out or sources[0] / "report", pages=pages, figures=figures or ()):
            if path.stem == "report":
                typer.echo(path)
        return
    target = out or sources[0].with_name(f"{'-'.join(one.stem for one in sources)}.report.html")
    page.write_report(target, *map(_page_of, sources))
    typer.echo(target)


def _page_of(path: Path) -> page.Recorded:
    if path.suffix not in (".mcap", ".jsonl"):
        return page.read_page(path)
    from missions.wires.mcap import read_page

    return read_page(path)
