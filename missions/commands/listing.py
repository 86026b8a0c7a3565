"""`rosa list` and `rosa settings`: which missions there are, and what can be set in them."""

from typing import Annotated

import typer

from missions import SUMMARIES
from missions.commands import MISSION, open_console


def list_missions() -> None:
    """List the missions."""
    wide = max(map(len, SUMMARIES)) + 2
    for name, summary in SUMMARIES.items():
        typer.echo(f"{name:<{wide}}{summary}")


def list_settings(
    mission: Annotated[str, typer.Argument(help=MISSION)],
    manager: Annotated[str, typer.Option(help="List what is to be set of this manager, too.")] = "ours",
) -> None:
    """List what `rosa run MISSION --set NAME=VALUE` takes, with default, unit, what is allowed, and source."""
    from missions.baselines.registry import options_of
    from missions.engine.mission import settings_of
    from missions.engine.registry import find_mission

    found, console = find_mission(mission), open_console()
    for setting in (*options_of(manager, found), *settings_of(found)):
        default = found.fixed.get(setting.name, setting.default)
        shown = f"{default:g}" if isinstance(default, float) else str(default)
        row = f"{setting.name:<32} {shown:>9} {setting.unit:<8} {setting.allowed}"
        console.print(row.rstrip(), style="bold", markup=False)
        console.print(f"    {setting.meaning} [{setting.source}]", style="dim", markup=False)
