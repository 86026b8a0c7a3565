"""How a run is opened under the manager that is asked for, ours or another."""

from collections.abc import Mapping
from typing import cast

from missions.managers.registry import OURS, find_manager
from missions.managers.run import ManagedRun
from missions.mission import Mission, MissionError
from missions.runner import Listener, MissionRun
from missions.sea import Sea
from missions.settings import split_settings
from missions.task import check_task

__all__ = ["open_run"]


def open_run(
    mission: Mission,
    *,
    manager: str = OURS,
    task: str = "bt",
    seed: int = 0,
    settings: Mapping[str, str] | None = None,
    listeners: tuple[Listener, ...] = (),
) -> MissionRun:
    """Open a run: the same mission, seed and settings mean the same world and the same chance, whoever manages it.

    Args:
        mission: what to run.
        manager: the name of a manager, or "package:Class".
        task: task layer of ours, "bt" or "pddl"; other managers bring their own.
        seed: of all chance in the run.
        settings: what differs from the defaults, by name; a unit at the end of a name may be left out.
        listeners: who hears of it.

    Returns:
        The run, ready for `run()`; under another manager than ours it is a `ManagedRun`.

    Raises:
        MissionError: no such manager, task layer or setting, or they do not go together.
    """
    import numpy

    check_task(task)
    managed_by = None if manager == OURS else find_manager(manager)
    run_settings, world_settings = split_settings(mission, settings or {})
    rng = numpy.random.default_rng(seed)
    world = mission.world.open(world_settings, rng)
    if managed_by is None:
        return MissionRun(mission, task, world, run_settings, listeners)
    if task != "bt":
        raise MissionError(f"--task {task} is a task layer of ours; --manager {manager} comes without one")
    if not isinstance(world, Sea):
        raise MissionError(f"mission {mission.name} does not happen in the sea; run it with --manager {OURS}")
    chance = rng.spawn(1)[0]
    managed = ManagedRun(mission, managed_by, world, run_settings, chance, listeners)
    return cast(MissionRun, managed)  # it has what reports and listeners look at
