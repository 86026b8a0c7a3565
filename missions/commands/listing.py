"""`rosa list` and `rosa settings`: which missions there are, and what can be set in them."""

from typing import Annotated

import typer

from missions.commands import open_console


def list_missions() -> None:
    """List the missions."""
    from rich.table import Table

    from missions.engine.registry import MISSIONS

    table = Table(box=None, pad_edge=False)
    table.add_column("mission", no_wrap=True)
    table.add_column("what happens in it")
    for mission in MISSIONS.values():
        table.add_row(mission.name, mission.summary)
    open_console().print(table)


def list_settings(
    mission: str, manager: Annotated[str, typer.Option(help="List what is to be set of this manager, too.")] = "ours"
) -> None:
    """List what `rosa run MISSION --set NAME=VALUE` takes, with default, unit, what is allowed, and source."""
    from rich.table import Column, Table

    from missions.baselines.registry import options_of
    from missions.engine.mission import settings_of
    from missions.engine.registry import find_mission

    short = [Column(name, no_wrap=True) for name in ("name", "default", "unit", "allowed")]
    short[1].justify = "right"
    long = [Column(name, ratio=1) for name in ("meaning", "source of the default")]
    table = Table(*short, *long, box=None, pad_edge=False)
    found = find_mission(mission)
    for setting in (*options_of(manager), *settings_of(found)):
        default = found.fixed.get(setting.name, setting.default)
        shown = f"{default:g}" if isinstance(default, float) else str(default)
        table.add_row(setting.name, shown, setting.unit, setting.allowed, setting.meaning, setting.source)
    open_console().print(table)
