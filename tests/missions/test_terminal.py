"""The view in a terminal at 80 by 24, beside a run."""

import asyncio
import time

import pytest
from textual.widgets import Static
from typer.testing import CliRunner

from missions import cli
from missions.baselines import open_run
from missions.engine.mission import find_mission
from missions.views.recorder import RunRecorder
from missions.views.terminal import TerminalView


@pytest.fixture(scope="module")
def recorder():
    """What there was to see of a battery drop."""
    run = open_run(find_mission("suave_extended"), settings={"duration_s": "160"})
    page = RunRecorder(run, 0, {}, what_if=False)
    page.end(run.run())
    return page.recorder


def shown(recorder, words=""):
    """Return what the panes show at the end of the run, and the line at the top.

    Of the log, only what has the words.
    """

    async def look():
        app = TerminalView(recorder)
        async with app.run_test(size=(80, 24)) as pilot:

            async def until(holds):
                end = time.monotonic() + 120.0
                while not holds():
                    assert time.monotonic() < end, app.sub_title
                    await pilot.pause(0.05)

            app.query_one("Input").value = words
            app.look()
            await until(
                lambda: (
                    "inspect_pipeline -> recharge"
                    in str(app.query_one("#adaptations", Static).content)
                )
            )
            panes = {name: str(app.query_one(f"#{name}", Static).content) for name in app.PANES}
            return (
                panes,
                app.sub_title,
                max(pane.region.right for pane in app.query("VerticalScroll")),
            )

    return asyncio.run(look())


def test_tree_statuses_adaptations_and_measurements_are_shown(recorder):
    panes, title, right = shown(recorder)
    assert "recharge if feasible" in panes["tree"]
    assert "✕ inspect_pipeline" in panes["known"]
    assert "battery_level" in panes["known"], "the reason"
    assert "recharge required" in panes["known"]
    assert "inspect_pipeline -> recharge" in panes["adaptations"]
    assert panes["adaptations"].index("recharge") < panes["adaptations"].index("12.6"), (
        "the latest first"
    )
    assert "water_visibility 3." in panes["known"]
    assert "aborted: " in title
    assert right <= 80


def test_program_that_is_to_end_does_not_wait_for_the_run_that_it_shows(monkeypatch):
    def ended(view):
        raise SystemExit(143)  # as SIGTERM does

    monkeypatch.setattr(TerminalView, "run", ended)
    start = time.monotonic()
    done = CliRunner().invoke(cli.app, ["run", "suave", "--tui", "--speed", "10"])
    assert done.exit_code == 143
    assert time.monotonic() - start < 15.0


def test_view_without_a_terminal_is_refused():
    done = CliRunner().invoke(cli.app, ["run", "suave", "--tui", "--set", "duration_s=1"])
    assert "a run in a terminal, and here is none" in str(done.exception)


def test_log_shows_what_happened_and_only_what_is_filtered(recorder):
    everything = shown(recorder)[0]["log"].splitlines()
    errors = shown(recorder, "error thruster")[0]["log"].splitlines()
    assert any("recharge is requested" in line for line in everything)
    assert 0 < len(errors) < len(everything)
    assert all("thruster" in line for line in errors)
    times = [float(line.partition(" s")[0]) for line in everything]
    assert times == sorted(times, reverse=True)
