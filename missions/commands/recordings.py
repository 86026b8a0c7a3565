"""`rosa replay` and `rosa record`: decide a recording once more, look into it, or convert it."""

import gc
from collections.abc import Iterable, Sequence
from difflib import unified_diff
from itertools import islice
from pathlib import Path
from typing import Annotated, Final

import typer
from rich.console import Console
from rich.table import Table

from kb import Event, KnowledgeBaseError
from kb.files import draft
from kb.model import differences
from missions.commands import FAILED, open_console
from missions.engine.mission import MISSION_STATUS, MISSIONS, MissionError, Verdict
from missions.engine.recording import line_of, read_recording
from missions.engine.runner import MissionRun
from missions.testing.decisions import Decisions
from missions.testing.decisions import replay as decide
from missions.views.breakpoints import watch_breakpoints
from missions.views.output import files_tried
from missions.views.recorder import RunRecorder
from missions.views.report import write_report
from missions.wires.mcap import Bag, is_bag, messages, read_bag, recorded_model, write_in_chunks

record = typer.Typer(
    help="Look at a recording, or put it in another form.",
    no_args_is_help=True,
    add_completion=False,
)

_DECISIVE: Final = ("request_action", "cancel_action", "select", "finish_plan")
"""The verbs of decisions and of their results."""
_SLACK_S: Final = 1e-6
_SHOWN: Final = 6
"""The largest number of differences to show."""


def replay(
    recording: Path,
    mission: Annotated[
        str | None, typer.Option(help="Who decides: a mission, or module:NAME; as recorded.")
    ] = None,
    task: Annotated[
        str | None, typer.Option(help="Its task layer, bt or pddl; by default as recorded.")
    ] = None,
    report: Annotated[
        Path | None, typer.Option(help="Write what is decided now as a page, as HTML.")
    ] = None,
    heard: Annotated[
        bool, typer.Option("--heard", help="Show also what was heard, not only what is decided.")
    ] = False,
    stop_at: Annotated[
        list[str] | None,
        typer.Option(
            "--break",
            metavar="CONDITION",
            help='Stop at a condition, such as "explore unfeasible".',
        ),
    ] = None,
) -> None:
    """Decide once more what was recorded; exit with 1 if that differs from what was decided then.

    A recording is a file of `rosa run --record`, or any rosbag2 with diagnostics, with MCAP or sqlite3.
    """
    gc.disable()  # messages and events are kept to the end; looking for garbage among them costs a third of the time
    try:
        bag = (
            read_bag(recording)
            if is_bag(recording)
            else Bag(messages=list(read_recording(recording)))
        )
        run = bag.run or (bag.messages[0].get("run", {}) if bag.messages else {})
        asked = mission or str(run.get("mission") or "")
        if not asked:
            raise MissionError(
                f"{recording} does not say which mission it is of; name one with --mission"
            )
        if not mission and asked not in MISSIONS and ":" not in asked:
            raise MissionError(
                f"{recording} is of a mission {asked!r} of your own; name it with --mission module:NAME"
            )
        pages: list[RunRecorder] = []
        runs: list[MissionRun] = []

        def watch(run_anew: MissionRun) -> None:
            runs.append(run_anew)
            pages.append(RunRecorder(run_anew, run.get("seed") or 0, {}))
            watch_breakpoints(run_anew, pages[0].recorder.rows, stop_at or ())

        by = task or run.get("task", "bt")
        watched = watch if report or stop_at else None
        decisions = decide(bag, asked, task=by, watch=watched, traced=False)
    finally:
        gc.enable()
    stopped = runs[0].trouble if runs else None
    if report is not None:
        words = f"decided once more from {recording.name}"
        pages[0].end(stopped or Verdict("replayed", words))
        write_report(report, pages[0].recorder.recorded)
    console = open_console()
    if "elements" in bag.run:
        model = decisions.kb.model
        try:
            changed = differences(recorded_model(bag), model, "recording")
        except KnowledgeBaseError as error:  # of another version
            changed = [str(error)]
        if changed:
            other = f"decided with {model.name}, which is another one:"
            console.print(f"recorded with the model {bag.run['model']}, {other}", markup=False)
        _print_differences(console, changed)
    for moment in decisions.timeline:
        if heard or moment.what != "heard":
            console.print(str(moment), markup=False, soft_wrap=True)
    _print_notes(console, bag)
    if decisions.problems:
        console.print(
            f"{len(decisions.problems)} parts of messages could not be used, e.g. {decisions.problems[0][1]}"
        )
    if stopped is not None:
        console.print(f"{stopped.reason}\n{stopped.detail}".rstrip(), markup=False)
        return
    silence = _silence(bag, decisions, asked)
    if silence:
        console.print(f"{recording} {silence}", markup=False)
        raise typer.Exit(FAILED)
    if not bag.events:
        return
    lines = unified_diff(
        _decisions(bag, bag.events), _decisions(bag, decisions.events), n=0, lineterm=""
    )
    otherwise = [
        f"{line[0]} {line[1:]}" for line in islice(lines, 2, None) if not line.startswith("@@")
    ]
    if not otherwise:
        console.print("decided as recorded")
        return
    console.print(
        f"[bold]decided otherwise from {otherwise[0].split()[1]} s on[/] (-: recorded, +: now)"
    )
    _print_differences(console, otherwise)
    raise typer.Exit(FAILED)


@record.command("info")
def info(recording: Path) -> None:
    """Say what a recording holds, and whether it is whole."""
    bag, console = read_bag(recording), open_console()
    known = [(key, bag.run.get(key)) for key in ("mission", "task", "seed", "model")]
    run = ", ".join(f"{key} {value}" for key, value in known if value is not None)
    times = [
        *(float(one["time"]) for one in bag.messages[-1:]),
        *(one.time for one in bag.events[-1:]),
    ]
    console.print(f"{recording}: {run or 'no recording of ours'}; {max(times, default=0.0):.1f} s")
    table = Table("topic", "type", "messages")
    for topic, (kind, count) in sorted(bag.topics.items()):
        table.add_row(topic, kind, str(count))
    console.print(table)
    _print_notes(console, bag)
    if bag.cut:
        raise typer.Exit(FAILED)


@record.command("convert")
def convert(recording: Path, output: Path) -> None:
    """Write a recording as MCAP (whole again if it was cut off), or what was heard as lines of JSON, by the suffix."""
    if output.suffix not in (".mcap", ".jsonl"):
        raise MissionError(
            f"{output} ends in neither .mcap nor .jsonl, which are what a recording is converted to"
        )
    bag = Bag()
    with (
        files_tried(f"write {output}"),
        draft(output) as part,
    ):  # an existing file stays until the new one is complete
        if output.suffix == ".jsonl":
            bag = read_bag(recording)
            part.write_text("".join(map(line_of, [bag.header(), *bag.messages])), encoding="utf-8")
        else:
            write_in_chunks(part, messages(recording, bag))
        part.replace(output)
    _print_notes(open_console(), bag)


def _silence(bag: Bag, decisions: Decisions, mission: str) -> str:
    """Return why a replay heard nothing, in words; empty if it heard something."""
    messages = [message for message in bag.messages if message["status"]]
    if not messages:
        return f"has no message of diagnostics, which is what {mission} hears"
    texts = {str(status["message"]).casefold() for one in messages for status in one["status"]}
    is_heard = any(moment.what == "heard" for moment in decisions.timeline)
    if is_heard or MISSION_STATUS in texts:
        return ""
    plural = "s" if len(messages) > 1 else ""
    count = f"{len(messages)} message{plural}"
    return f"was not understood: nothing in its {count} of diagnostics says anything to {mission}"


def _print_notes(console: Console, bag: Bag) -> None:
    notes = [f"{bag.cut}; all before that is read"] if bag.cut else []
    for note in [
        *notes,
        *(f"not read, {count} times: {problem}" for problem, count in bag.problems.items()),
    ]:
        console.print(note, style="yellow", markup=False)


def _print_differences(console: Console, lines: Sequence[str]) -> None:
    for line in [
        *lines[:_SHOWN],
        *([f"... and {len(lines) - _SHOWN} more"] if len(lines) > _SHOWN else []),
    ]:
        console.print(line, markup=False)


def _decisions(bag: Bag, events: Iterable[Event]) -> list[str]:
    """Return a line for each decision up to the end of the recording; what stops a robot by hand is no decision."""
    outcomes = [row[3]["outcome"] for _, row in bag.rows if row[1] == "result"]
    is_stopped = bool(bag.cut) or all(outcome == "aborted" for outcome in outcomes)
    end_s = max(one.time for one in bag.events) + (-_SLACK_S if is_stopped else _SLACK_S)
    return [_line(one) for one in events if one.verb in _DECISIVE and one.time <= end_s]


def _line(event: Event) -> str:
    decided = (
        event.arguments[:2] if event.verb in ("cancel_action", "select") else event.arguments
    )  # no reason
    values = ", ".join(str(one) for one in decided if one not in (None, "", (), {}))
    return f"{event.time:9.3f} s  {event.verb.replace('_', ' ')}: {values}"
