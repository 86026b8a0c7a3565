"""Play the rounds of a counterexample with the real parts, and tell them in words, as a trace, a page or a test."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from pprint import pformat
from typing import Any

from missions.proof.rig import Change, Rig, Setup
from missions.proof.rounds import Step
from missions.testing.scripted import LETTERS
from rosa_bt import Trace, TraceVisitor

Rounds = tuple[Any, Any, Any]
"""A `Step`, or the same as plain tuples."""


@dataclass(frozen=True)
class Story:
    """What happened when the rounds of a counterexample were run.

    Attributes:
        lines: in words.
        trace: of the ticks; a round takes a second.
        wrong: what is wrong at the end, in words, if the last situation alone shows it.
        rig: the parts of the mission, as they are at the end.
    """

    lines: tuple[str, ...]
    trace: Trace
    wrong: tuple[str, ...]
    rig: Rig

    def __str__(self) -> str:
        return "\n".join(self.lines)


def play(
    setup: Setup, trail: Sequence[Rounds], page: str | Path | None = None, rows: Iterable[Any] = ()
) -> Story:
    """Run the rounds of a story; if `page` is given, write a page of it there, with these additional rows."""
    steps = [
        Step(tuple(Change(*one) for one in changes), answers, late)
        for changes, answers, late in trail
    ]
    rig = Rig(setup)
    recorder = None
    if page is not None:
        from missions.views.recorder import Recorder

        recorder = Recorder(rig.kb, rig.runner)
        for row in rows:
            recorder.put(*row)
    lines: list[str] = []
    rig.kb.subscribe(
        lambda event: (
            lines.append(f"      {event.text}") if event.verb in _SHOWN or event.plan else None
        )
    )
    with TraceVisitor(rig.kb) as visitor:
        faults = list(rig.begin())
        rig.runner.tree.add_visitor(visitor)
        for number, step in enumerate(steps, start=1):
            rig.clock = float(number)
            happens = "; ".join(map(str, step.changes)) or "nothing happens"
            late = " (the manager is late)" if step.late[0] else ""
            answers = ", ".join(f"{name} {LETTERS[letter].name}" for name, letter in step.answers)
            lines.append(f"  {number}. {happens}{late}; {answers or 'no leaf is asked'}")
            for change in step.changes:
                change.tell(rig.kb)
            faults += [] if step.late[0] else rig.settle()
            before = set(rig.unfeasible)
            rig.choices.begin(step.answers)
            rig.runner.tick()
            faults += [] if step.late[1] else rig.settle()
            late_ones = before & set(rig.unfeasible)
        trace = visitor.trace
    if recorder is not None and page is not None:
        recorder.close()
        recorder.report(str(page))
    running = {one.action for one in rig.doing if one.status.name == "RUNNING"}
    wrong = [
        *faults,
        *(
            f"{one} is requested while it is unfeasible"
            for one in sorted(late_ones if steps else ())
        ),
    ]
    wrong += [
        f"{one} is requested or runs, not both" for one in sorted(running ^ set(rig.required))
    ]
    return Story(tuple(lines), trace, tuple(wrong), rig)


_SHOWN = ("request_action", "cancel_action")


def as_test(setup: str, name: str, what: str, trail: Sequence[Step]) -> str:
    """Return a test for pytest that plays a story, and fails as long as the story can happen.

    Args:
        setup: an expression that makes the `Setup`, with the imports that it needs as lines before it.
        name: of the property.
        what: what is wrong.
        trail: the rounds.
    """
    *imports, expression = setup.splitlines()
    rounds = [(tuple(map(tuple, step.changes)), step.answers, step.late) for step in trail]
    function = "".join(letter if letter.isalnum() else "_" for letter in name.lower())
    imported = "\n".join([*imports, "from missions.proof.story import play"])
    return f'''"""A story that `rosa verify` has found."""

{imported}

SETUP = {expression}
ROUNDS = {pformat(rounds, width=110)}


def test_{function}():
    story = play(SETUP, ROUNDS)  # {what}
    assert not story.wrong, story
'''
