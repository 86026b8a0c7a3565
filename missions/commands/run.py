"""`rosa run`: run a mission, show what happens and why, and write files."""

import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, nullcontext
from pathlib import Path
from typing import Annotated, Any

from typer import Argument, Exit, Option

from missions.baselines import open_run
from missions.commands import (
    FAILED,
    MISSION,
    Breakpoints,
    File,
    Text,
    Texts,
    assignments,
    open_console,
    print_lines,
)
from missions.engine.faults import FORMS, read_fault
from missions.engine.mission import MissionError, Verdict, find_mission, needs
from missions.engine.recording import LineRecorder, header
from missions.engine.runner import MissionRun, RosaRun
from missions.views.breakpoints import watch_breakpoints
from missions.views.console import Narrator, print_result
from missions.views.live import KEEP, LiveView, Steering
from missions.views.output import as_json, files_tried, open_files, summary
from missions.views.recorder import RunRecorder
from missions.views.report import report as page_of

_MANAGERS = "ours, none, random, bt, fixed, or package:Class; at sea also metacontrol, rosa, ahead."


def _fault(verb: str, text: str) -> Any:  # noqa: ANN401  # what typer makes of an option
    return Option(metavar=FORMS[verb], help=text)


def run(
    mission: Annotated[str, Argument(help=MISSION)],
    task: Annotated[
        Text, Option(help="By a tree (bt) or plans (pddl); default: what is there.")
    ] = None,
    manager: Annotated[str, Option(help=_MANAGERS)] = "ours",
    seed: Annotated[int, Option(min=0, help="Seed of all chance in the run.")] = 0,
    json: Annotated[File, Option(help="Write the result as JSON.")] = None,
    plot: Annotated[File, Option(help="Draw the run as a PNG picture.")] = None,
    report: Annotated[File, Option(help="Write the run as an HTML page.")] = None,
    record: Annotated[
        File, Option(help="Record as FILE.mcap, or diagnostics as lines of JSON.")
    ] = None,
    settings: Annotated[Texts, Option("--set", metavar="NAME=VALUE", help="Change it.")] = None,
    fail: Annotated[Texts, _fault("fail", "Fail a component at a time [s].")] = None,
    recover: Annotated[Texts, _fault("recover", "Recover a component at a time [s].")] = None,
    measure: Annotated[Texts, _fault("measure", "Replace a measurement from a time [s].")] = None,
    release: Annotated[Texts, _fault("release", "End that replacement at a time [s].")] = None,
    stop_at: Breakpoints = None,
    groot2: Annotated[
        int | None, Option(metavar="PORT", help="Let Groot2 watch the tree (port 1667).")
    ] = None,
    live: Annotated[
        int | None, Option(metavar="PORT", help="Show the run as a page meanwhile (0: any port).")
    ] = None,
    host: Annotated[str, Option(help="Where --live listens.")] = "127.0.0.1",
    token: Annotated[Text, Option(help="The token of --host; default: a random one.")] = None,
    allow_control: Annotated[
        bool, Option("--allow-control", help="Allow pause, step and fault injection on the page.")
    ] = False,
    tui: Annotated[bool, Option("--tui", help="Show the run in the terminal; q leaves.")] = False,
    speed: Annotated[
        float | None,
        Option(help="Times real time at most, 0: no limit; default 1 with --live and --tui."),
    ] = None,
    progress: Annotated[
        bool, Option("--progress/--no-progress", help="Show what happens meanwhile.")
    ] = True,
) -> None:
    """Run a mission, say what happened and why, and exit with 0 if it did what it was for."""
    if plot is not None:
        with needs("plot", "a picture of the run"):
            import matplotlib  # noqa: F401  # if it is missing, say so before the run
    chosen = find_mission(mission)
    changed = assignments(settings, "--set")
    verbs = {"fail": fail, "recover": recover, "measure": measure, "release": release}
    faults = [read_fault(f"{verb} {text}") for verb, texts in verbs.items() for text in texts or ()]
    is_mcap = record is not None and record.suffix == ".mcap"
    is_shown = tui or live is not None
    is_drawn = bool(report or plot)
    console = open_console()
    with ExitStack() as stack:
        paths = {"json": json, "plot": plot, "report": report}
        files = open_files(paths | {"record": None if is_mcap else record})
        opened = open_run(chosen, manager=manager, task=task, seed=seed, settings=changed)
        opened.faults.add(*faults)
        if speed is None:
            speed = 1.0 if is_shown else 0.0
        steering = Steering(opened, speed)
        progress = progress and not tui
        narrator = Narrator(console, opened.settings.duration_s)
        if progress:
            opened.listen(narrator)
        if groot2 is not None:
            _publish(opened, groot2, stack)
        if record is not None and not is_mcap:
            LineRecorder(opened, seed, _lines_written(record, stack))
        page = None
        if is_drawn or is_mcap or is_shown or stop_at:
            keep = KEEP if live is not None and not is_drawn else None
            page = RunRecorder(opened, seed, changed, keep, what_if=report is not None)
            if is_shown:
                steering.breakpoints.watch(page.recorder.rows)
                steering.breakpoints.set(stop_at or ())
            else:
                watch_breakpoints(opened, page.recorder.rows, stop_at or ())
        opened.listen(steering)
        if page and live is not None:
            view = LiveView(
                page.recorder.kb,
                port=live,
                host=host,
                token=token,
                recorder=page.recorder,
                steering=steering if allow_control else None,
            )
            stack.callback(view.close)
            console.print(f"live: {view.url}", soft_wrap=True)
        if page and record is not None and is_mcap:
            from missions.wires.mcap import McapRecorder

            tree = opened.tree if isinstance(opened, RosaRun) else None
            about = header(opened, seed)["run"]
            bag = McapRecorder(record, opened.kb, tree, page=page.recorder, run=about)
            stack.callback(_print_refused, bag.refused)  # when the file is complete
            opened.listen(stack.enter_context(bag))
        with narrator.progress if progress else nullcontext():
            doing = f"task layer: {opened.task}" if manager == "ours" else f"manager: {manager}"
            console.print(f"[bold]{chosen.name}[/] ({doing}, seed {seed})")
            start = time.perf_counter()
            try:
                verdict = _watched(opened, page, steering) if tui and page else opened.run()
            except KeyboardInterrupt:
                verdict = Verdict("aborted", f"stopped by hand after {opened.world.now:.1f} s")
            wall_s = time.perf_counter() - start
        print_result(console, opened, verdict, wall_s, with_adaptations=not progress)
        data = summary(opened, verdict, seed, changed) | {"manager": manager}
        if "json" in files:
            files["json"].finish(as_json(data))
        if page:
            page.end(verdict)
        if page and "report" in files:
            files["report"].finish(page_of(page.recorder.recorded))
        if page and "plot" in files:  # last, because it takes longest
            from missions.views.picture import draw

            files["plot"].finish(draw(page.recorder.recorded))
    if not verdict.success:
        raise Exit(FAILED)


def _lines_written(path: Path, stack: ExitStack) -> Callable[[str], None]:
    """Return a function that writes a line at once, also for a program that is killed."""
    with files_tried(f"write {path}"):
        file = stack.enter_context(path.open("wb", buffering=0))

    def write(line: str) -> None:
        with files_tried(f"write {path}"):
            file.write(line.encode())

    return write


def _print_refused(refused: dict[str, int]) -> None:
    lines = (f"not recorded, {count} times: {problem}" for problem, count in refused.items())
    print_lines(lines, "yellow")


def _watched(run: MissionRun, page: RunRecorder, steering: Steering) -> Verdict:
    """Run in a thread beside the view in the terminal; leaving the view stops the run."""
    from missions.views.terminal import TerminalView

    view = TerminalView(page.recorder, steering)
    with ThreadPoolExecutor(1, "mission") as pool:
        going = pool.submit(run.run)
        try:
            view.run()
        finally:  # also when the program is to end
            if not going.done():
                run.early_verdict = Verdict(
                    "aborted", f"stopped by hand after {run.world.now:.1f} s"
                )
                steering.do({"do": "speed", "value": 0})
                steering.do({"do": "resume"})
        return going.result()


def _publish(run: MissionRun, port: int, stack: ExitStack) -> None:
    from missions.wires.groot2 import Groot2Publisher

    if run.tree is None:
        raise MissionError(f"manager {run.manager} ticks no tree that Groot2 could watch")
    stack.callback(Groot2Publisher(run.tree, port).close)
