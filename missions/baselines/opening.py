"""How a run is opened: who decides in it is ours, or the manager that is asked for."""

from collections.abc import Mapping

from missions.baselines.controller import BaselineController
from missions.baselines.manager import Manager
from missions.baselines.options import split_options
from missions.baselines.registry import find_manager, name_of, options_of
from missions.engine.controller import OURS, check_task, rosa_run
from missions.engine.mission import Mission, MissionError
from missions.engine.runner import Listener, MissionRun
from missions.engine.settings import split_settings
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
) -> MissionRun:
    """Open a run: the same mission, seed and settings mean the same world and the same chance, whoever manages it.

    Args:
        mission: what to run.
        manager: the name of a manager, "package:Class", or the class itself.
        task: task layer of ours, "bt" or "pddl"; other managers bring their own.
        seed: of all chance in the run.
        settings: what differs from the defaults, by name; a unit at the end of a name may be left out.
        listeners: who hears of it.

    Returns:
        The run, ready for `run()`.

    Raises:
        MissionError: no such manager, task layer or setting, or they do not go together.
    """
    import numpy

    check_task(task)
    managed_by = None if manager == OURS else find_manager(manager)
    options, values = split_options(options_of(manager), settings or {})
    run_settings, world_settings = split_settings(mission, values)
    rng = numpy.random.default_rng(seed)
    world = mission.world.open(world_settings, rng)
    if managed_by is None:
        return rosa_run(mission, task, world, run_settings, listeners)
    if not isinstance(world, Sea):
        raise MissionError(
            f"mission {mission.name} can be run with manager {OURS} only, as --task bt or --task pddl: "
            f"{name_of(managed_by)} commands the nodes of the sea's vehicle, and {mission.name} does not happen in the "
            "sea"
        )
    if task != "bt":
        raise MissionError(f"--task {task} is a task layer of ours; --manager {manager} comes without one")
    published = [one.name for one in managed_by.options if one.is_published]
    controller = BaselineController(mission, managed_by, world, rng.spawn(1)[0], options, published)
    return MissionRun(mission, controller, world, run_settings, listeners)
