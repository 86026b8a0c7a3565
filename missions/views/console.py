"""Prints a run on the console: what happens, as it happens, and the result."""

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, Final

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    ProgressColumn,
    TextColumn,
    TimeRemainingColumn,
)
from rich.text import Text

from kb import DiagnosticProblem
from missions.engine.adaptations import Adaptation
from missions.engine.mission import Verdict
from missions.engine.runner import Listener, MissionRun
from missions.views.output import figure_in_words

if TYPE_CHECKING:
    from rosa_pddl import PlanRecord

COLOURS: Final = {"parameter": "cyan", "structural": "yellow", "task": "magenta"}
_INDENT: Final = 11
"""Width of the time at the start of a line [characters]."""


def print_line(console: Console, head: str, *parts: str | tuple[str, str]) -> None:
    """Print a line; on a terminal it is wrapped, and its next lines are indented."""
    text = Text.assemble(*parts)
    is_wrapped = not console.soft_wrap
    lines = text.wrap(console, max(console.width - _INDENT, 20)) if is_wrapped else [text]
    for line in lines:
        console.print(Text.assemble((f"{head:<{_INDENT}}", "dim"), line))
        head = ""


def _progress(console: Console, *columns: ProgressColumn) -> Progress:
    """Return a progress bar that is shown while it is open, and on a terminal only."""
    return Progress(*columns, console=console, transient=True, disable=not console.is_terminal)


class Narrator(Listener):
    """Prints events above a progress bar of `duration_s` simulated seconds."""

    def __init__(self, console: Console, duration_s: float) -> None:
        begin = TextColumn("{task.completed:5.1f} s")
        end = TextColumn("{task.total:.0f} s  {task.description}")
        self._console = console
        self.progress = _progress(console, begin, BarColumn(), end)
        self._printed_problems: set[tuple[str, str]] = set()
        self._bar = self.progress.add_task("", total=duration_s)

    def action(self, text: str, time_s: float) -> None:
        if " is unfeasible because " in text:  # the adaptation says why
            text = text.partition(" because ")[0]
        self._print(time_s, text)

    def adaptation(self, adaptation: Adaptation) -> None:
        _print_adaptation(self._console, adaptation)

    def plan(self, plan: "PlanRecord", time_s: float) -> None:
        result = f"none, {plan.outcome} ({plan.engine})"
        if plan.outcome.is_solved:
            result = ", then ".join(step.action or step.schema for step in plan.steps)
        self._print(time_s, ("plan", "bold green"), f" ({plan.reason}): {result}")

    def problem(self, problem: DiagnosticProblem, time_s: float) -> None:
        key = (problem.key, problem.reason)
        if key not in self._printed_problems:
            self._printed_problems.add(key)
            self._print(time_s, ("diagnostics not used", "bold red"), f": {problem}")

    def tick(self, run: MissionRun) -> None:
        if self.progress.disable:
            return
        open_actions = [action.action for action in run.actions if action.end is None]
        values = [
            f"{name} {value:.2f}" for name, value in run.measured.items() if value is not None
        ]
        words = f"{', '.join(open_actions) or 'deciding'}  [dim]{', '.join(values)}[/]"
        self.progress.update(self._bar, completed=run.world.now, description=words)

    def _print(self, time_s: float, *parts: str | tuple[str, str]) -> None:
        print_line(self._console, f"{time_s:7.1f} s", *parts)


class CampaignProgress:
    """Shows the progress of a campaign, the time left, and each run that crashes.

    The bar is shown while `progress` is open.
    """

    def __init__(self, console: Console) -> None:
        self.count = self.total = self.new = self.crashed = 0
        left = TextColumn("left  {task.description}", markup=False)
        columns = (BarColumn(), MofNCompleteColumn(), TimeRemainingColumn(), left)
        self._console = console
        self.progress = _progress(console, *columns)
        self._bar = self.progress.add_task("", total=None)

    def begin(self, done: int, total: int) -> None:
        self.count = done
        self.total = total
        self.progress.update(self._bar, completed=done, total=total)

    def done(self, record: Mapping[str, Any]) -> None:
        """Move the bar; without a terminal, print a line for each tenth of the campaign."""
        before = self.count * 10 // self.total
        self.count += 1
        self.new += 1
        if record["outcome"] == "crashed":
            self.crashed += 1
            words = f"{record['run']} crashed: {record['error']}; repeat it: {record['rerun']}"
            self._console.print(words, style="bold red", markup=False)
        self.progress.update(self._bar, completed=self.count, description=record["run"])
        if self.progress.disable and self.count * 10 // self.total > before:
            self._console.print(f"{self.count}/{self.total} runs", style="dim", markup=False)


def print_result(
    console: Console, run: MissionRun, verdict: Verdict, wall_s: float, *, with_adaptations: bool
) -> None:
    """Print the figures and the verdict of a run that has ended, and its adaptations on request."""
    for adaptation in run.adaptations if with_adaptations else ():
        _print_adaptation(console, adaptation)
    figures = {**run.results(), "simulated_s": run.world.now, "computed in_s": wall_s}
    shown = [figure_in_words(name, value, run.model) for name, value in figures.items()]
    shown.append(("times real time", "", f"{run.world.now / wall_s:.1f}"))
    for words, unit, value in shown:
        label = f"{words} [{unit}]" if unit else words
        console.print(f"{label:<32}{value:>8}", markup=False)
    if run.problems:
        _, first = run.problems[0]
        text = f"{len(run.problems)} parts of diagnostics were not used, the first: {first}"
        console.print(text, style="yellow", markup=False)
    for finding in run.findings:
        console.print(finding, style="yellow", markup=False)
    colour = "green" if verdict.success else "red"
    console.print(Text.assemble((verdict.outcome, f"bold {colour}"), f": {verdict.reason}"))
    if verdict.detail:
        console.print(verdict.detail, markup=False)


def _print_adaptation(console: Console, adaptation: Adaptation) -> None:
    reaction = adaptation.reaction_s
    soon = "not carried out" if reaction is None else f"in force {reaction:.2f} s after the news"
    kind = (f"{adaptation.kind} adaptation", f"bold {COLOURS[adaptation.kind]}")
    print_line(console, f"{adaptation.at_s:7.1f} s", kind, f": {adaptation.change}")
    print_line(console, "", f"why: {adaptation.why}; {soon}")
