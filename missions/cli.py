"""The command line: `rosa`, the same as `python -m missions`."""

import logging
import signal
import sys
import time
from contextlib import ExitStack, nullcontext, suppress
from io import BytesIO
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from kb import KnowledgeBaseError
from kb.judge.findings import Severity
from missions.baselines import MANAGERS, OURS, open_run
from missions.baselines.options import split_options
from missions.baselines.registry import options_of
from missions.checking import inconsistencies, judge, print_judgement
from missions.engine.mission import MissionError, Verdict
from missions.engine.recording import header, line_of
from missions.engine.registry import MISSIONS, find_mission
from missions.engine.runner import Listener, MissionRun
from missions.engine.settings import describe, split_settings
from missions.experiments.campaign_command import campaign, report
from missions.experiments.effort_command import effort
from missions.live import Narrator, Pace, Recorder
from missions.output import open_files
from missions.plan_command import plan
from missions.report import adaptation_table, as_json, figure_in_words, summary, timing
from rosa_pddl import RosaPddlError

__all__ = ["app", "main"]

FAILED, WRONG_USE = 1, 2

app = typer.Typer(
    help="Run missions of robots that adapt what they do and how they are built.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
)


@app.command("list")
def list_missions() -> None:
    """List the missions."""
    table = Table(box=None, pad_edge=False)
    table.add_column("mission", no_wrap=True)
    table.add_column("what happens in it")
    for mission in MISSIONS.values():
        table.add_row(mission.name, mission.summary)
    _console().print(table)


@app.command("settings")
def list_settings(
    mission: str,
    manager: Annotated[str, typer.Option(help="List what is to be set of this manager, too.")] = OURS,
) -> None:
    """List what `rosa run MISSION --set NAME=VALUE` takes, with default, unit, what is allowed, and source."""
    table = Table(box=None, pad_edge=False)
    for column in ("name", "default", "unit", "allowed"):
        table.add_column(column, no_wrap=True, justify="right" if column == "default" else "left")
    table.add_column("meaning", ratio=1)
    table.add_column("source of the default", ratio=1)
    found = find_mission(mission)
    for setting in (*options_of(manager), *describe(found)):
        default = found.fixed.get(setting.name, setting.default)
        shown = f"{default:g}" if isinstance(default, float) else str(default)
        allowed = getattr(setting, "allowed", "")  # a world of one's own may not say it
        table.add_row(setting.name, shown, setting.unit, allowed, setting.meaning, setting.source)
    _console().print(table)


@app.command("run")
def run_mission(
    mission: str,
    task: Annotated[str, typer.Option(help="Task layer of ours: bt (behaviour tree) or pddl (planned).")] = "bt",
    manager: Annotated[
        str, typer.Option(help=f"{OURS}, {', '.join(MANAGERS)}, or one of your own: package:Class.")
    ] = OURS,
    rules: Annotated[str | None, typer.Option(help="Rules of SUAVE: 2024 (the ROSA paper) or 2025.")] = None,
    seed: Annotated[int, typer.Option(min=0, help="Seed of all chance in the run.")] = 0,
    json: Annotated[Path | None, typer.Option(help="Write the result as JSON.")] = None,
    plot: Annotated[Path | None, typer.Option(help="Draw the run as a PNG picture.")] = None,
    timing_file: Annotated[Path | None, typer.Option("--timing", help="Write the compute times as JSON.")] = None,
    record: Annotated[Path | None, typer.Option(help="Write the diagnostics, one message per line.")] = None,
    settings: Annotated[list[str] | None, typer.Option("--set", metavar="NAME=VALUE", help="Change a setting.")] = None,
    charge_compute: Annotated[
        bool, typer.Option("--charge-compute", help="What the manager computes takes simulated time.")
    ] = False,
    realtime: Annotated[bool, typer.Option("--realtime", help="Run no faster than the wall clock.")] = False,
    progress: Annotated[bool, typer.Option("--progress/--no-progress", help="Show what happens meanwhile.")] = True,
) -> None:
    """Run a mission, say what happened and why, and exit with 0 if it did what it was for."""
    found = find_mission(mission)
    changed = _assignments(settings or []) | ({} if rules is None else {"rules": rules})
    _, of_mission = split_options(options_of(manager), changed)
    run_settings, _ = split_settings(found, of_mission)
    console = _console()
    wanted = {"json": json, "plot": plot, "timing": timing_file, "record": record}
    with ExitStack() as stack:
        files = open_files({name: path for name, path in wanted.items() if path is not None}, stack)
        listeners: list[Listener] = []
        if "record" in files:
            listeners.append(Recorder(files["record"]))
        if realtime:
            listeners.append(Pace())
        narrator = Narrator(console, run_settings.duration_s)
        if progress:
            listeners.append(narrator)
        run = open_run(
            found,
            manager=manager,
            task=task,
            seed=seed,
            settings=changed,
            listeners=tuple(listeners),
            charge_compute=charge_compute,
        )
        if "record" in files:
            files["record"].write(line_of(header(run, seed)))
        with narrator if progress else nullcontext():
            console.print(f"[bold]{found.name}[/] ({_doing(task, manager)}, seed {seed})")
            start = time.perf_counter()
            verdict = _run(run)
            wall_s = time.perf_counter() - start
        if run.adaptations and not progress:  # otherwise each was told as it happened
            console.print(adaptation_table(run.adaptations))
        _print_figures(console, run, wall_s)
        _print_verdict(console, run, verdict)
        data = summary(run, verdict, seed, changed) | {"manager": manager}
        texts = {"json": as_json(data), "timing": as_json(timing(run, wall_s)), "record": ""}
        for name in texts.keys() & files.keys():
            files[name].write(texts[name])
            files[name].keep()
        if "plot" in files:  # last, because it takes longest
            from missions.plot import draw

            picture = BytesIO()
            draw(run, data, picture)
            files["plot"].write(picture.getvalue())
            files["plot"].keep()
    if not verdict.success:
        raise typer.Exit(FAILED)


@app.command("check")
def check(
    files: Annotated[list[Path] | None, typer.Argument(help="Files of a model, each may add to those before.")] = None,
    mission: Annotated[str | None, typer.Option(help="Check with its tree and PDDL, or its own model.")] = None,
    tree: Annotated[list[str] | None, typer.Option(metavar="MODULE:CALLABLE", help="A tree that uses it.")] = None,
    pddl: Annotated[list[Path] | None, typer.Option(help="A PDDL domain or problem that uses it.")] = None,
    strict: Annotated[bool, typer.Option("--strict", help="Exit with 1 for warnings too.")] = False,
    json: Annotated[bool, typer.Option("--json", help="Print the findings as JSON.")] = False,
    reason: Annotated[bool, typer.Option("--reason", help="Have HermiT look for contradictions; needs Java.")] = False,
) -> None:
    """Judge a model, say what to do about each finding, and exit with 0 if nothing in it can never work."""
    of = find_mission(mission) if mission else None
    found = judge(files or [], of, tree or [], pddl or [])
    contradictions = inconsistencies(files or [], of) if reason else []
    for one in contradictions:
        _complain(one)
    if json:
        typer.echo(found.as_json())
    else:
        print_judgement(_console(), found)
        if reason and not contradictions:
            _console().print("HermiT finds no contradiction", highlight=False)
    if found.of(Severity.ERROR) or contradictions or (strict and found.findings):
        raise typer.Exit(FAILED)


app.command("plan")(plan)
app.command("campaign")(campaign)
app.command("report")(report)
app.command("effort")(effort)


def main() -> None:
    """Run the command line; what goes wrong is one clear message, never a traceback."""
    sys.path.append(str(Path.cwd()))  # where a mission of one's own is, given as module:NAME
    logging.basicConfig(level=logging.ERROR, format="rosa: %(message)s")  # what is less is told by the narrator
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(128 + signal.SIGTERM))  # so that no draft of a file stays
    try:
        app()
    except (MissionError, KnowledgeBaseError, RosaPddlError) as error:
        _complain(str(error))
        sys.exit(WRONG_USE)
    except OSError as error:  # standard output is full or gone
        with suppress(OSError):
            sys.stdout.close()
        _complain(f"cannot print: {error.strerror or error}")
        sys.exit(FAILED)


def _complain(text: str) -> None:
    console = Console(stderr=True, soft_wrap=True, emoji=False)
    console.print(f"[bold red]rosa:[/] {escape(text)}", highlight=False)


def _doing(task: str, manager: str) -> str:
    return f"task layer: {task}" if manager == OURS else f"manager: {manager}"


def _run(run: MissionRun) -> Verdict:
    try:
        return run.run()
    except KeyboardInterrupt:
        return Verdict("aborted", f"stopped by hand after {run.world.now:.1f} s")


def _assignments(texts: list[str]) -> dict[str, str]:
    values = {}
    for text in texts:
        name, equals, value = text.partition("=")
        if not equals or not name:
            raise MissionError(f"--set takes NAME=VALUE, not {text!r}")
        values[name.strip()] = value.strip()
    return values


def _print_figures(console: Console, run: MissionRun, wall_s: float) -> None:
    told = [figure_in_words(name, value) for name, value in run.world.results().items()]
    told += [figure_in_words("simulated_s", run.world.now), figure_in_words("computed in_s", wall_s)]
    told += [("times real time", "", f"{run.world.now / wall_s:.1f}")]
    for words, unit, value in told:
        console.print(f"{words + (f' [{unit}]' if unit else ''):<32}{value:>8}", highlight=False, markup=False)


def _print_verdict(console: Console, run: MissionRun, verdict: Verdict) -> None:
    if run.problems:
        _, first = run.problems[0]
        text = f"{len(run.problems)} parts of diagnostics were not used, the first: {first}"
        console.print(f"[yellow]{escape(text)}[/]", highlight=False)
    colour = "green" if verdict.success else "red"
    console.print(f"[bold {colour}]{verdict.outcome}[/]: {escape(verdict.reason)}", highlight=False)
    if verdict.detail:
        console.print(escape(verdict.detail), highlight=False)


def _console() -> Console:
    console = Console(emoji=False)
    if not console.is_terminal:
        console.width = 160  # a pipe or a file has no width of its own
    return console
