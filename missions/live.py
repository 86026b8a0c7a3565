"""What a person sees while a mission runs: what the robot does, and each adaptation with its reason as it happens."""

import time
from typing import TYPE_CHECKING

from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, Progress, TextColumn

from kb import DiagnosticProblem
from missions.engine.adaptations import Adaptation
from missions.engine.mission import Message
from missions.engine.recording import line_of
from missions.engine.runner import Listener, MissionRun
from missions.output import OutputFile

if TYPE_CHECKING:
    from rosa_pddl import PlanRecord

__all__ = ["Narrator", "Pace", "Recorder"]

COLOURS = {"parameter": "cyan", "structural": "yellow", "task": "magenta"}


class Narrator(Listener):
    """Prints what happens, above a bar that shows the time.

    Args:
        console: where to print.
        duration_s: length of the bar [s].
    """

    def __init__(self, console: Console, duration_s: float) -> None:
        self._console = console
        self._known_problems: set[tuple[str, str]] = set()
        columns = (
            TextColumn("{task.completed:5.1f} s"),
            BarColumn(),
            TextColumn("{task.total:.0f} s  {task.description}"),
        )
        self._progress = Progress(*columns, console=console, transient=True, disable=not console.is_terminal)
        self._bar = self._progress.add_task("", total=duration_s)

    def __enter__(self) -> "Narrator":
        self._progress.start()
        return self

    def __exit__(self, *reason: object) -> None:
        self._progress.stop()

    def action(self, text: str, time_s: float) -> None:
        """Say what the mission begins or ends."""
        self._say(time_s, escape(text))

    def adaptation(self, adaptation: Adaptation) -> None:
        """Say what was changed, why, and how soon."""
        colour = COLOURS[adaptation.kind]
        reaction = adaptation.reaction_s
        soon = f"in force {reaction:.2f} s after the news" if reaction is not None else "not carried out"
        self._say(adaptation.at_s, f"[bold {colour}]{adaptation.kind} adaptation[/]: {escape(adaptation.change)}")
        self._console.print(f"{'':11}why: {escape(adaptation.why)}; {soon}", highlight=False)

    def plan(self, plan: "PlanRecord", time_s: float) -> None:
        """Say what is planned, and why it was planned anew."""
        steps = ", then ".join(step.action or step.schema for step in plan.steps)
        found = steps if plan.outcome.is_solved else f"none, {plan.outcome} ({plan.engine})"
        self._say(time_s, f"[bold green]plan[/] ({escape(plan.reason)}): {escape(found)}")

    def problem(self, problem: DiagnosticProblem, time_s: float) -> None:
        """Say what could not be used, the first time."""
        if (problem.key, problem.reason) not in self._known_problems:
            self._known_problems.add((problem.key, problem.reason))
            self._say(time_s, f"[bold red]diagnostics not used[/]: {escape(str(problem))}")

    def tick(self, run: MissionRun) -> None:
        """Move the bar, and show what is being done and seen."""
        if self._progress.disable:
            return
        doing = ", ".join(required.action for required in run.kb.required_actions) or "deciding"
        measured = ((name, view.value) for name, view in run.kb.attributes.items())
        seen = ", ".join(f"{name} {value:.2f}" for name, value in measured if value is not None)
        self._progress.update(self._bar, completed=run.world.now, description=f"{doing}  [dim]{seen}[/]")

    def _say(self, time_s: float, text: str) -> None:
        self._console.print(f"[dim]{time_s:7.1f} s[/]  {text}", highlight=False)


class Recorder(Listener):
    """Writes every message to a file, one per line."""

    def __init__(self, output: OutputFile) -> None:
        self._output = output

    def message(self, message: Message) -> None:
        """Write the message."""
        self._output.write(line_of(message))


class Pace(Listener):
    """Holds a simulated run back to the pace of the wall clock."""

    def __init__(self) -> None:
        self._start = time.monotonic()

    def tick(self, run: MissionRun) -> None:
        """Wait until the wall clock has come as far as the simulated one."""
        time.sleep(max(0.0, self._start + run.world.now - time.monotonic()))
