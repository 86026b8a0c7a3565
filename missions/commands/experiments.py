"""`rosa campaign`, `rosa report` and `rosa learn`: many runs, and what came of them."""

from dataclasses import replace
from pathlib import Path
from time import perf_counter
from typing import Annotated

from rich.console import Console
from rich.markup import escape
from typer import Argument, Exit, Option, echo

from missions.commands import FAILED, ROBOT, File, Text, Texts, print_lines
from missions.engine.mission import MissionError, find_robot, needs
from missions.experiments.campaign import Campaign, check_campaign, paper_table, read_campaign
from missions.experiments.learning import learn as learned_from
from missions.experiments.learning import read_runs
from missions.experiments.results import Results, Store
from missions.experiments.workers import cluster as open_cluster
from missions.experiments.workers import conduct, processes
from missions.views.console import CampaignProgress
from missions.views.report import write_report as write_page


def campaign(
    file: Annotated[File, Argument(metavar="FILE.toml", help="What to run.")] = None,
    table: Annotated[
        bool, Option("--paper-table", help="The table of the ROSA paper: 100 runs each.")
    ] = False,
    runs: Annotated[
        int | None, Option(min=1, help="How many of each, whatever the file says.")
    ] = None,
    workers: Annotated[
        int | None, Option(min=1, help="Processes on this machine; default: all cores.")
    ] = None,
    cluster: Annotated[
        Text, Option(metavar="ADDRESS", help="Of the scheduler of a dask cluster.")
    ] = None,
    resume: Annotated[bool, Option("--resume", help="Go on with the campaign in DIR.")] = False,
    retry: Annotated[
        bool, Option("--retry", help="With --resume: also repeat runs that crashed.")
    ] = False,
    out: Annotated[File, Option(metavar="DIR", help="Where; default: campaigns/NAME.")] = None,
) -> None:
    """Run missions with many managers, settings and seeds; exit with 0 if no run crashed."""
    asked = _asked(file, table, runs)
    if workers is not None and cluster is not None:
        raise MissionError("give --workers N for this machine or --cluster ADDRESS, not both")
    if retry and not resume:
        raise MissionError("--retry goes with --resume")
    if asked is None and not (resume and out):
        raise MissionError("say what to run: FILE.toml or --paper-table, or --resume --out DIR")
    if asked is not None:
        check_campaign(asked)
    folder = out or Path("campaigns") / (asked.name if asked else "")
    console = Console(emoji=False, soft_wrap=True, highlight=False)
    shown = CampaignProgress(console)
    started = perf_counter()
    with Store(folder, asked, resume=resume) as store:
        try:
            chosen = processes(workers) if cluster is None else open_cluster(cluster)
            console.print(
                f"[bold]{escape(store.campaign.name)}[/] in {escape(str(folder))}"
                f", {chosen.size} at a time"
            )
            with shown.progress:
                written = conduct(store, folder, chosen, retry=retry, progress=shown)
        except (KeyboardInterrupt, SystemExit, MissionError):
            named = f" {file}" if store.campaign.own_modules else ""  # see Store
            again = escape(f"rosa campaign{named} --resume --out {folder}")
            console.print(f"{shown.count} of {shown.total} runs are done and kept; go on: {again}")
            raise
    took = perf_counter() - started
    console.print(
        f"{shown.count} of {shown.total} runs done, {shown.new} of them now in {took:.1f} s"
        f" ({shown.new / took:.2f} a second); {shown.crashed} crashed"
    )
    console.print(f"written: {', '.join(escape(str(path)) for path in written)}")
    console.print(f"`rosa report {escape(str(folder))}` says what came of it")
    if shown.crashed:
        raise Exit(FAILED)


def _asked(file: Path | None, table: bool, runs: int | None) -> Campaign | None:
    if file is not None and table:
        raise MissionError("give either FILE.toml or --paper-table")
    if file is None and not table:
        if runs is not None:
            raise MissionError("--runs goes with FILE.toml or --paper-table")
        return None
    campaign = paper_table() if file is None else read_campaign(file)
    return campaign if runs is None else replace(campaign, runs=runs)


def report(
    source: Annotated[
        Path, Argument(metavar="DIR | RECORDING", help="A campaign's folder, or a recording.")
    ],
    out: Annotated[
        File,
        Option(
            "--out",
            "-o",
            help="Where to write; default: DIR/report, or the recording's name with .html.",
        ),
    ] = None,
    figures: Annotated[Texts, Option("--figure", help="Of a campaign: compare by these.")] = None,
) -> None:
    """Write the report on a campaign, as report.md and report.html, or a recording as a page."""
    if source.is_file() or source.suffix in (".mcap", ".jsonl"):
        from missions.wires.mcap import read_page

        target = out or source.with_suffix(".report.html")
        write_page(target, read_page(source))
        echo(target)
        return
    results = Results(source)
    with needs("plot", "the report on a campaign"):  # before anything is written
        import matplotlib  # noqa: F401  # if it is missing
        import scipy  # noqa: F401  # if it is missing
    from missions.experiments.report import write_report

    for path in write_report(results, out or source / "report", figures=figures or ()):
        if path.stem == "report":
            echo(path)


def learn(
    runs: Annotated[list[Path], Argument(help="Recordings.")],
    model: Annotated[str, Option(help=ROBOT)],
) -> None:
    """Compare a model with runs: rates and durations, each with its interval."""
    print_lines(learned_from(read_runs(runs), find_robot(model)[0]))
