"""Prints a run on the console: what happens, as it happens, and the result."""

import time
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from rich.console import Console
from rich.markup import escape
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    ProgressColumn,
    TextColumn,
    TimeRemainingColumn,
)

from kb import DiagnosticProblem
from missions.engine.adaptations import Adaptation
from missions.engine.mission import Verdict
from missions.engine.runner import Listener, MissionRun
from missions.views.output import figure_in_words

if TYPE_CHECKING:
    from rosa_pddl import PlanRecord

COLOURS = {"parameter": "cyan", "structural": "yellow", "task": "magenta"}


def _progress(console: Console, *columns: ProgressColumn) -> Progress:
    """Return a progress bar that is shown while it is open, and on a terminal only."""
    return Progress(*columns, console=console, transient=True, disable=not console.is_terminal)


class Narrator(Listener):
    """Prints what happens, above a bar of `duration_s` simulated seconds, shown while `progress` is open."""

    def __init__(self, console: Console, duration_s: float) -> None:
        begin, end = (
            TextColumn("{task.completed:5.1f} s"),
            TextColumn("{task.total:.0f} s  {task.description}"),
        )
        self._console, self.progress = console, _progress(console, begin, BarColumn(), end)
        self._known_problems: set[tuple[str, str]] = set()
        self._bar = self.progress.add_task("", total=duration_s)

    def action(self, text: str, time_s: float) -> None:
        short = (
            text.partition(" because ")[0] if " is unfeasible because " in text else text
        )  # the adaptation says why
        _say(self._console, time_s, escape(short))

    def adaptation(self, adaptation: Adaptation) -> None:
        _print_adaptation(self._console, adaptation)

    def plan(self, plan: "PlanRecord", time_s: float) -> None:
        steps = ", then ".join(step.action or step.schema for step in plan.steps)
        found = steps if plan.outcome.is_solved else f"none, {plan.outcome} ({plan.engine})"
        _say(self._console, time_s, f"[bold green]plan[/] ({escape(plan.reason)}): {escape(found)}")

    def problem(self, problem: DiagnosticProblem, time_s: float) -> None:
        if (problem.key, problem.reason) not in self._known_problems:
            self._known_problems.add((problem.key, problem.reason))
            _say(
                self._console, time_s, f"[bold red]diagnostics not used[/]: {escape(str(problem))}"
            )

    def tick(self, run: MissionRun) -> None:
        if self.progress.disable:
            return
        doing = ", ".join(one.action for one in run.actions if one.end is None) or "deciding"
        measured = run.measured.items()
        seen = ", ".join(f"{name} {value:.2f}" for name, value in measured if value is not None)
        self.progress.update(
            self._bar, completed=run.world.now, description=f"{doing}  [dim]{seen}[/]"
        )


class CampaignProgress:
    """Shows how far a campaign is, its rate and the time left, and each run that crashes.

    The bar is shown while `progress` is open.
    """

    def __init__(self, console: Console) -> None:
        self.count = self.total = self.new = self.crashed = 0
        rate, left = (
            TextColumn("{task.fields[rate]:.2f} a second,"),
            TextColumn("left  [dim]{task.description}[/]"),
        )
        self._console = console
        self.progress = _progress(
            console, BarColumn(), MofNCompleteColumn(), rate, TimeRemainingColumn(), left
        )
        self._started = time.perf_counter()
        self._bar = self.progress.add_task("", total=None, rate=0.0)

    def begin(self, done: int, total: int) -> None:
        self._started = time.perf_counter()
        self.count, self.total = done, total
        self.progress.update(self._bar, completed=done, total=total)

    def done(self, record: Mapping[str, Any]) -> None:
        """Move the bar; without a terminal, print a line for each tenth of the campaign."""
        self.count, self.new = self.count + 1, self.new + 1
        if record["outcome"] == "crashed":
            self.crashed += 1
            self._print(
                "bold red", f"{record['run']} crashed: {record['error']}; again: {record['rerun']}"
            )
        rate = self.new / max(time.perf_counter() - self._started, 1e-9)
        self.progress.update(
            self._bar, completed=self.count, rate=rate, description=escape(record["run"])
        )
        if (
            self.progress.disable
            and self.count * 10 // self.total > (self.count - 1) * 10 // self.total
        ):
            left = (self.total - self.count) / rate
            self._print(
                "dim", f"{self.count}/{self.total} runs, {rate:.2f} a second, {left:.0f} s left"
            )

    def note(self, text: str) -> None:
        self._print("yellow", text)

    def _print(self, style: str, text: str) -> None:
        self._console.print(text, style=style, markup=False)


def print_result(
    console: Console, run: MissionRun, verdict: Verdict, wall_s: float, *, with_adaptations: bool
) -> None:
    """Print the figures and the verdict of a run that has ended, and its adaptations if asked for."""
    for adaptation in run.adaptations if with_adaptations else ():
        _print_adaptation(console, adaptation)
    figures = {**run.results(), "simulated_s": run.world.now, "computed in_s": wall_s}
    shown = [figure_in_words(name, value, run.model) for name, value in figures.items()]
    for words, unit, value in [*shown, ("times real time", "", f"{run.world.now / wall_s:.1f}")]:
        console.print(f"{words + (f' [{unit}]' if unit else ''):<32}{value:>8}", markup=False)
    if run.problems:
        _, first = run.problems[0]
        text = f"{len(run.problems)} parts of diagnostics were not used, the first: {first}"
        console.print(f"[yellow]{escape(text)}[/]")
    for finding in run.findings:
        console.print(f"[yellow]{escape(finding)}[/]")
    colour = "green" if verdict.success else "red"
    console.print(f"[bold {colour}]{verdict.outcome}[/]: {escape(verdict.reason)}")
    if verdict.detail:
        console.print(escape(verdict.detail))


def _print_adaptation(console: Console, adaptation: Adaptation) -> None:
    reaction = adaptation.reaction_s
    soon = (
        f"in force {reaction:.2f} s after the news" if reaction is not None else "not carried out"
    )
    kind = f"[bold {COLOURS[adaptation.kind]}]{adaptation.kind} adaptation[/]"
    _say(console, adaptation.at_s, f"{kind}: {escape(adaptation.change)}")
    console.print(f"{'':11}why: {escape(adaptation.why)}; {soon}")


def _say(console: Console, time_s: float, text: str) -> None:
    console.print(f"[dim]{time_s:7.1f} s[/]  {text}")
