"""`rosa campaign`: many runs on all cores or on a cluster, gone on with after whatever stopped it; `rosa report`."""

import shlex
from collections.abc import Callable, Mapping
from contextlib import closing
from pathlib import Path
from time import perf_counter
from typing import Annotated, Any, Self

import typer
from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from missions.engine.mission import MissionError
from missions.experiments.campaign import Campaign, check_campaign, paper_table, read_campaign, with_runs
from missions.experiments.results import Store, read_store
from missions.experiments.work import CRASHED
from missions.experiments.workers import Cluster, Processes, Workers, conduct, modules_needed

__all__ = ["campaign", "report"]

FAILED = 1
TENTHS = 10


def campaign(
    file: Annotated[Path | None, typer.Argument(metavar="FILE.toml", help="What to run.")] = None,
    table: Annotated[bool, typer.Option("--paper-table", help="The table of the ROSA paper: 100 runs each.")] = False,
    runs: Annotated[int | None, typer.Option(help="How many of each, whatever the file says.")] = None,
    workers: Annotated[int | None, typer.Option(min=1, help="Processes on this machine; default: all cores.")] = None,
    cluster: Annotated[str | None, typer.Option(metavar="ADDRESS", help="Of the scheduler of a dask cluster.")] = None,
    resume: Annotated[bool, typer.Option("--resume", help="Go on with the campaign in DIR.")] = False,
    retry: Annotated[bool, typer.Option("--retry", help="With --resume: also repeat runs that crashed.")] = False,
    out: Annotated[Path | None, typer.Option(metavar="DIR", help="Where; default: campaigns/NAME.")] = None,
) -> None:
    """Run missions with many managers, settings and seeds, and exit with 0 if none of the runs crashed."""
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
    console = Console(emoji=False, soft_wrap=True)
    with Store(folder, asked, resume=resume) as store:
        again = f"rosa campaign --resume --out {shlex.quote(str(folder))}" + (
            f" --cluster {cluster}" if cluster else ""
        )
        crashed = _conduct(console, store, folder, _open(cluster, workers, store.campaign), retry, again)
    if crashed:
        raise typer.Exit(FAILED)


def report(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="Where the campaign is.")],
    out: Annotated[Path | None, typer.Option(metavar="DIR", help="Where to write; default: DIR/report.")] = None,
) -> None:
    """Say what came of a campaign, as report.md and report.html with pictures: published figures beside ours, tests."""
    kept = read_store(folder)
    from missions.experiments.report import write_report

    written = write_report(kept, out or folder / "report")
    for path in written:
        if path.suffix in (".md", ".html"):
            typer.echo(path)


def _asked(file: Path | None, table: bool, runs: int | None) -> Campaign | None:
    if file is not None and table:
        raise MissionError("give either FILE.toml or --paper-table")
    if file is None and not table:
        if runs is not None:
            raise MissionError("--runs goes with FILE.toml or --paper-table")
        return None
    return with_runs(paper_table() if file is None else read_campaign(file), runs)


def _open(cluster: str | None, workers: int | None, asked: Campaign) -> Callable[[], Workers]:
    if cluster is None:
        return lambda: Processes(workers)
    return lambda: Cluster(cluster, modules_needed(asked))


def _conduct(
    console: Console, store: Store, folder: Path, open_workers: Callable[[], Workers], retry: bool, again: str
) -> int:
    """Run the campaign, tell of it, and return how many runs crashed."""
    teller = _Teller(console)
    started = perf_counter()
    try:
        with closing(open_workers()) as workers, teller:
            console.print(f"[bold]{escape(store.campaign.name)}[/] in {escape(str(folder))}, {workers.count} at a time")
            written = conduct(store, folder, workers, retry=retry, teller=teller)
    except (KeyboardInterrupt, SystemExit, MissionError):
        console.print(f"{teller.count} of {teller.total} runs are done and kept; go on with\n  {escape(again)}")
        raise
    took = perf_counter() - started
    console.print(
        f"{teller.count} of {teller.total} runs done, {teller.new} of them now in {took:.1f} s"
        f" ({teller.new / took:.2f} a second); {teller.crashed} crashed",
        highlight=False,
    )
    console.print(f"written: {', '.join(escape(str(path)) for path in written)}", highlight=False)
    console.print(f"`rosa report {escape(str(folder))}` says what came of it", highlight=False)
    return teller.crashed


class _Teller:
    """Shows how far a campaign is, how fast it goes and how long it will take, and each run that crashes."""

    def __init__(self, console: Console) -> None:
        self.count = self.total = self.new = self.crashed = 0
        self._console = console
        self._shows = console.is_terminal
        self._started = perf_counter()
        self._progress = Progress(
            BarColumn(),
            MofNCompleteColumn(),
            TextColumn("{task.fields[rate]:.2f} a second,"),
            TimeRemainingColumn(),
            TextColumn("left  [dim]{task.description}[/]"),
            console=console,
            transient=True,
        )
        self._bar = self._progress.add_task("", total=None, rate=0.0)

    def __enter__(self) -> Self:
        if self._shows:
            self._progress.start()
        return self

    def __exit__(self, *reason: object) -> None:
        if self._shows:
            self._progress.stop()

    def begin(self, done: int, total: int) -> None:
        """Start the clock."""
        self._started = perf_counter()
        self.count, self.total = done, total
        self._progress.update(self._bar, completed=done, total=total)

    def done(self, record: Mapping[str, Any]) -> None:
        """Move the bar; without a terminal, print a line for each tenth of the campaign."""
        self.count, self.new = self.count + 1, self.new + 1
        if record["outcome"] == CRASHED:
            self.crashed += 1
            self._print("bold red", f"{record['run']} crashed: {record['error']}; again: {record['rerun']}")
        rate = self.new / max(perf_counter() - self._started, 1e-9)
        self._progress.update(self._bar, completed=self.count, rate=rate, description=escape(record["run"]))
        if not self._shows and self.count * TENTHS // self.total > (self.count - 1) * TENTHS // self.total:
            left = (self.total - self.count) / rate
            self._print("dim", f"{self.count}/{self.total} runs, {rate:.2f} a second, {left:.0f} s left")

    def note(self, text: str) -> None:
        """Say what keeps the runs from being done."""
        self._print("yellow", text)

    def _print(self, style: str, text: str) -> None:
        self._console.print(text, style=style, highlight=False, markup=False)
