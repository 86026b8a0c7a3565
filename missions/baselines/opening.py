"""How a run is opened under the manager that is asked for, ours or another."""

from collections.abc import Iterable, Mapping
from typing import cast

from missions.baselines.manager import Manager
from missions.baselines.options import Option, split_options
from missions.baselines.registry import OURS, find_manager, name_of, options_of
from missions.baselines.run import ManagedRun
from missions.baselines.watch import Aside, WatchedSea
from missions.engine.mission import Mission, MissionError
from missions.engine.runner import Listener, MissionRun
from missions.engine.settings import split_settings
from missions.engine.task_layer import check_task
from missions.suave.world import Sea

__all__ = ["open_run"]


def open_run(
    mission: Mission,
    *,
    manager: str | type[Manager] = OURS,
    task: str = "bt",
    seed: int = 0,
    settings: Mapping[str, str] | None = None,
    listeners: tuple[Listener, ...] = (),
    charge_compute: bool = False,
) -> MissionRun:
    """Open a run: the same mission, seed and settings mean the same world and the same chance, whoever manages it.

    Args:
        mission: what to run.
        manager: the name of a manager, "package:Class", or the class itself.
        task: task layer of ours, "bt" or "pddl"; other managers bring their own.
        seed: of all chance in the run.
        settings: what differs from the defaults, by name; a unit at the end of a name may be left out.
        listeners: who hears of it.
        charge_compute: whether the time that the manager takes on this machine passes in the sea, too; its figures then
            have `compute_charged_s` and are not the same to the byte again. No other delay of planning is assumed.

    Returns:
        The run, ready for `run()`; under another manager than ours it is a `ManagedRun`. In the sea, its `world` is a
        `WatchedSea`, which knows the reaction times.

    Raises:
        MissionError: no such manager, task layer or setting, or they do not go together.
    """
    import numpy

    check_task(task)
    managed_by = None if manager == OURS else find_manager(manager)
    options, values = split_options(options_of(manager), settings or {})
    if charge_compute and "planning_delay" not in values:
        values = {"planning_delay_s": "0"} | values
    run_settings, world_settings = split_settings(mission, values)
    rng = numpy.random.default_rng(seed)
    world = mission.world.open(world_settings, rng)
    if isinstance(world, Sea):
        world = WatchedSea(world, charges=charge_compute, inputs=_published(options_of(manager), options))
        listeners = (Aside(listeners, world),) if listeners else ()
    elif charge_compute or managed_by is not None:
        raise MissionError(_refusal(mission, None if managed_by is None else name_of(managed_by)))
    if managed_by is None:
        return MissionRun(mission, task, world, run_settings, listeners)
    if task != "bt":
        raise MissionError(f"--task {task} is a task layer of ours; --manager {manager} comes without one")
    chance = rng.spawn(1)[0]
    managed = ManagedRun(mission, managed_by, cast(Sea, world), run_settings, chance, listeners, options)
    return cast(MissionRun, managed)  # it has what reports and listeners look at


def _refusal(mission: Mission, manager: str | None) -> str:
    if manager is None:
        return f"--charge-compute charges what passes in the sea, and mission {mission.name} does not happen there"
    return (
        f"mission {mission.name} can be run with manager {OURS} only, as --task bt or --task pddl: "
        f"{manager} commands the nodes of the sea's vehicle, and {mission.name} does not happen in the sea"
    )


def _published(options: Iterable[Option], values: Mapping[str, float]) -> dict[str, float]:
    """Return the values that were taken from published results of the manager."""
    return {one.name: values[one.name] for one in options if one.is_published}
