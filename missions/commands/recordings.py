"""`rosa replay` and `rosa record`: what was recorded, decided once more, looked at, and put in another form."""

import gc
from collections.abc import Iterator, Sequence
from difflib import SequenceMatcher
from pathlib import Path
from typing import Annotated, Final

import typer
from rich.table import Table

from kb import Event, Model
from kb.files import draft
from kb.typeql.writer import typeql_text
from missions.commands import FAILED, open_console
from missions.engine.mission import MissionError, Verdict
from missions.engine.recording import line_of, read_recording
from missions.engine.registry import MISSIONS
from missions.engine.runner import MissionRun
from missions.testing.recorded import replay as decide
from missions.views.report import write_report
from missions.views.run_recorder import RunRecorder
from missions.wires.bags import Bag, Reader, is_bag, read_bag
from missions.wires.mcap import McapFile

record = typer.Typer(help="Look at a recording, or put it in another form.", no_args_is_help=True, add_completion=False)

_DECISIVE: Final = ("request_action", "cancel_action", "select", "finish_plan")
"""The verbs of what was decided, and of how it ended."""
_SLACK_S: Final = 1e-6
_SHOWN: Final = 6
"""How many differences are shown at most."""


def replay(
    recording: Path,
    mission: Annotated[str | None, typer.Option(help="Who decides: a mission, or module:NAME; as recorded.")] = None,
    task: Annotated[str | None, typer.Option(help="Its task layer, bt or pddl; by default as recorded.")] = None,
    report: Annotated[Path | None, typer.Option(help="Write what is decided now as a page, as HTML.")] = None,
    heard: Annotated[bool, typer.Option("--heard", help="Show also what was heard, not only what is decided.")] = False,
) -> None:
    """Decide once more what was recorded; exit with 1 if that differs from what was decided then.

    A recording is a file of `rosa run --record`, or any rosbag2 with diagnostics, with MCAP or sqlite3.
    """
    gc.disable()  # what is heard and known is held to the end: to look for garbage in it takes a third of the time
    try:
        bag = read_bag(recording) if is_bag(recording) else Bag(messages=list(read_recording(recording)))
        run = bag.run or (bag.messages[0].get("run", {}) if bag.messages else {})
        asked = mission or run.get("mission")
        if not asked:
            raise MissionError(f"{recording} does not say which mission it is of; name one with --mission")
        if not mission and asked not in MISSIONS and ":" not in asked:
            raise MissionError(f"{recording} is of a mission {asked!r} of your own; name it with --mission module:NAME")
        pages: list[RunRecorder] = []

        def watch(run_anew: MissionRun) -> None:
            pages.append(RunRecorder(run_anew, run.get("seed") or 0, {}))

        source, by = bag if is_bag(recording) else bag.messages, task or run.get("task", "bt")
        decisions = decide(source, asked, task=by, strict=False, watch=watch if report else None, traced=False)
    finally:
        gc.enable()
    if report is not None:
        pages[0].end(Verdict("replayed", f"decided once more from {recording.name}"))
        write_report(report, pages[0].recorder.recorded)
    console = open_console()
    if (recorded := bag.run.get("typeql")) and (changed := _changed(recorded, decisions.kb.model)):
        console.print(f"recorded with the model {bag.run['model']}, decided with {changed}", markup=False)
    for moment in decisions.timeline:
        if heard or moment.what != "heard":
            console.print(str(moment), markup=False, soft_wrap=True)
    for note in _notes(bag):
        console.print(note, style="yellow", markup=False)
    if decisions.problems:
        console.print(f"{len(decisions.problems)} parts of messages could not be used, e.g. {decisions.problems[0][1]}")
    if not bag.events:
        return
    differences = _differences(bag, decisions.events)
    if not differences:
        console.print("decided as recorded")
        return
    console.print(f"[bold]decided otherwise from {differences[0][0]:.2f} s on[/] (-: recorded, +: now)")
    for _, text in differences[:_SHOWN]:
        console.print(text, markup=False)
    if len(differences) > _SHOWN:
        console.print(f"... and {len(differences) - _SHOWN} more")
    raise typer.Exit(FAILED)


@record.command("info")
def info(recording: Path) -> None:
    """Say what a recording holds, and whether it is whole."""
    bag, console = read_bag(recording), open_console()
    told = [(key, bag.run.get(key)) for key in ("mission", "task", "seed", "model")]
    run = ", ".join(f"{key} {value}" for key, value in told if value is not None)
    console.print(f"{recording}: {run or 'no recording of ours'}; {bag.duration_s:.1f} s")
    table = Table("topic", "type", "messages")
    for topic, (kind, count) in sorted(bag.topics.items()):
        table.add_row(topic, kind, str(count))
    console.print(table)
    for note in _notes(bag):
        console.print(note, style="yellow", markup=False)
    if bag.cut:
        raise typer.Exit(FAILED)


@record.command("convert")
def convert(recording: Path, output: Path) -> None:
    """Write a recording as MCAP (whole again if it was cut off), or what was heard as lines of JSON, by the suffix."""
    if output.suffix not in (".mcap", ".jsonl"):
        raise MissionError(f"{output} ends in neither .mcap nor .jsonl, which are what a recording is converted to")
    bag: Bag | Reader
    try:
        with draft(output) as part:  # what is there stays until the new one is whole
            if output.suffix == ".jsonl":
                bag = read_bag(recording)
                part.write_text("".join(map(line_of, [bag.header(), *bag.messages])), encoding="utf-8")
            else:
                bag = Reader(recording)
                with McapFile(part) as file:
                    for raw in bag:
                        file.copy(*raw)
            part.replace(output)
    except OSError as error:
        raise MissionError(f"cannot write {output}: {error.strerror or error}") from None
    console = open_console()
    for note in _notes(bag):
        console.print(note, style="yellow", markup=False)


def _notes(bag: Bag | Reader) -> Iterator[str]:
    if bag.cut:
        yield f"{bag.cut}; all before that is read"
    for problem, count in bag.problems.items():
        yield f"not read, {count} times: {problem}"


def _changed(recorded: str, model: Model) -> str:
    """Return what is another model than the recorded one, in words; nothing if it is the same."""
    then, now = (dict.fromkeys(text.splitlines()) for text in (recorded, typeql_text(model)))
    lines = [f"- {one}" for one in then if one not in now] + [f"+ {one}" for one in now if one not in then]
    if not lines:
        return ""
    more = [f"... and {len(lines) - _SHOWN} more"] if len(lines) > _SHOWN else []
    return "\n".join([f"{model.name}, which is another one (-: recorded, +: now)", *lines[:_SHOWN], *more])


def _differences(bag: Bag, events: Sequence[Event]) -> list[tuple[float, str]]:
    """Return when and how it was decided otherwise; what comes after the recording's end is no difference."""
    end_s = max(one.time for one in bag.events) + (-_SLACK_S if bag.cut else _SLACK_S)
    then, now = ([one for one in some if one.verb in _DECISIVE and one.time <= end_s] for some in (bag.events, events))
    lines = list(map(_line, then)), list(map(_line, now))
    found = []
    for same, start, end, now_start, now_end in SequenceMatcher(None, *lines, autojunk=False).get_opcodes():
        if same != "equal":
            found += [(one.time, f"- {_line(one)}") for one in then[start:end]]
            found += [(one.time, f"+ {_line(one)}") for one in now[now_start:now_end]]
    return found


def _line(event: Event) -> str:
    decided = event.arguments[:2] if event.verb in ("cancel_action", "select") else event.arguments  # without why
    values = ", ".join(str(one) for one in decided if one not in (None, "", (), {}))
    return f"{event.time:9.3f} s  {event.verb.replace('_', ' ')}: {values}"
