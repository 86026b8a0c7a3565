"""`rosa replay`: decide a recording again."""

import gc
import json
from collections.abc import Iterable
from difflib import unified_diff
from itertools import islice
from pathlib import Path
from typing import Annotated, Final

from typer import Exit, Option

from kb import Event
from missions.commands import FAILED, Breakpoints, File, Text, open_console, print_lines
from missions.engine.mission import MISSIONS, MissionError, Verdict
from missions.engine.percepts import MISSION_STATUS
from missions.engine.recording import read_recording
from missions.engine.runner import MissionRun
from missions.testing.decisions import Decisions
from missions.testing.decisions import replay as decide
from missions.views.breakpoints import watch_breakpoints
from missions.views.recorder import RunRecorder
from missions.views.report import write_report
from missions.wires.mcap import Bag, is_bag, read_bag

_DECISIVE: Final = ("request_action", "cancel_action", "select", "finish_plan")
"""The verbs of decisions and of their results."""
_SLACK_S: Final = 1e-6
_SHOWN: Final = 6
"""The largest number of differences to show."""


def replay(
    recording: Path,
    mission: Annotated[
        Text, Option(help="Who decides: a mission, or module:NAME; default: as recorded.")
    ] = None,
    task: Annotated[Text, Option(help="Its task layer, bt or pddl; default: as recorded.")] = None,
    report: Annotated[File, Option(help="Write the new decisions as an HTML page.")] = None,
    stop_at: Breakpoints = None,
) -> None:
    """Decide again what was recorded; exit with 1 if that differs from the recorded decisions.

    A recording is a file of `rosa run --record`, or any rosbag2 with diagnostics.
    """
    gc.disable()  # nothing is garbage until the end; looking for it costs a third of the time
    try:
        bag = read_bag(recording) if is_bag(recording) else Bag([*read_recording(recording)])
        run = bag.run or (bag.messages[0].get("run", {}) if bag.messages else {})
        name = mission or str(run.get("mission") or "")
        if not name:
            raise MissionError(f"{recording} names no mission; name one with --mission")
        if not mission and name not in MISSIONS and ":" not in name:
            raise MissionError(
                f"{recording} is of a mission {name!r} of your own; "
                "name it with --mission module:NAME"
            )
        pages: list[RunRecorder] = []
        runs: list[MissionRun] = []

        def watch(again: MissionRun) -> None:
            runs.append(again)
            pages.append(RunRecorder(again, run.get("seed") or 0, {}))
            watch_breakpoints(again, pages[0].recorder.rows, stop_at or ())

        watched = watch if report or stop_at else None
        task = task or run.get("task", "bt")
        decisions = decide(bag, name, task=task, watch=watched)
    finally:
        gc.enable()
    stopped = runs[0].early_verdict if runs else None
    if report is not None:
        pages[0].end(stopped or Verdict("replayed", f"decided once more from {recording.name}"))
        write_report(report, pages[0].recorder.recorded)
    model = json.loads(json.dumps(decisions.kb.model.plain()))
    if bag.run.get("elements", model) != model:
        print_lines(["it is decided with another model than the recorded one"], "bold")
    for moment in decisions.timeline:
        if moment.what != "heard":
            open_console().print(str(moment), markup=False, soft_wrap=True)
    _print_notes(bag)
    if decisions.problems:
        print_lines(
            [
                f"{len(decisions.problems)} parts of messages "
                f"could not be used, e.g. {decisions.problems[0][1]}"
            ]
        )
    if stopped is not None:
        print_lines([f"{stopped.reason}\n{stopped.detail}".rstrip()])
        return
    silence = _silence(bag, decisions, name)
    if silence:
        print_lines([f"{recording} {silence}"])
        raise Exit(FAILED)
    if not bag.events:
        print_lines(["the recording has no decisions to compare with"])
        return
    before = _decisions(bag, bag.events)
    now = _decisions(bag, decisions.events)
    lines = islice(unified_diff(before, now, n=0, lineterm=""), 2, None)
    otherwise = [f"{line[0]} {line[1:]}" for line in lines if not line.startswith("@@")]
    if not otherwise:
        print_lines(["decided as recorded"])
        return
    start_s = otherwise[0].split()[1]
    title = (
        f"decided otherwise from {start_s} s on (-: recorded, +: now), in {len(otherwise)} lines"
    )
    print_lines([title], "bold")
    print_lines(otherwise[:_SHOWN])
    raise Exit(FAILED)


def _silence(bag: Bag, decisions: Decisions, mission: str) -> str:
    """Return why a replay heard nothing, in words; empty if it heard something."""
    statuses = [message["status"] for message in bag.messages if message["status"]]
    if not statuses:
        return f"has no message of diagnostics, which is what {mission} hears"
    texts = {str(status["message"]).casefold() for some in statuses for status in some}
    if MISSION_STATUS in texts or any(moment.what == "heard" for moment in decisions.timeline):
        return ""
    return (
        "was not understood: nothing in its "
        f"{len(statuses)} message{'s' if len(statuses) > 1 else ''}"
        f" of diagnostics says anything to {mission}"
    )


def _print_notes(bag: Bag) -> None:
    if bag.cut:
        print_lines([f"{bag.cut}; all before that is read"], "yellow")
    problems = bag.problems.items()
    print_lines((f"not read, {count} times: {problem}" for problem, count in problems), "yellow")


def _decisions(bag: Bag, events: Iterable[Event]) -> list[str]:
    """Return a line for each decision up to the end of the recording.

    What stops a robot by hand is no decision.
    """
    outcomes = [row[3]["outcome"] for _, row in bag.rows if row[1] == "result"]
    is_stopped = bool(bag.cut) or all(outcome == "aborted" for outcome in outcomes)
    end_s = max(event.time for event in bag.events) + (-_SLACK_S if is_stopped else _SLACK_S)
    return [_line(event) for event in events if event.verb in _DECISIVE and event.time <= end_s]


def _line(event: Event) -> str:
    has_reason = event.verb in ("cancel_action", "select")
    values = event.arguments[:2] if has_reason else event.arguments
    text = ", ".join(str(value) for value in values if value not in (None, "", (), {}))
    return f"{event.time:9.3f} s  {event.verb.replace('_', ' ')}: {text}"
