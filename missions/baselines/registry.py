"""The managers there are, by name, and how a run is opened under the one that is asked for."""

from collections.abc import Mapping

from missions.baselines.manager import Manager
from missions.engine.controller import OURS, check_task, rosa_run
from missions.engine.mission import Mission, MissionError, split_settings
from missions.engine.registry import Registry
from missions.engine.runner import Listener, MissionRun
from missions.engine.settings import Setting, own_values, read_values
from missions.extras import needs

MANAGERS: Registry[type[Manager]] = Registry(
    "manager",
    {
        "none": "missions.baselines.modes:NoManager",
        "random": "missions.baselines.modes:RandomManager",
        "bt": "missions.baselines.bt:TreeManager",
        "metacontrol": "missions.baselines.metacontrol:Metacontrol",
        "rosa": "missions.baselines.rosa:RosaManager",
    },
)
"""All but ours."""


def find_manager(name: str | type[Manager]) -> type[Manager]:
    """Return a manager by its name, or as "package:Class" from anywhere that Python imports from; a class is itself.

    Raises:
        MissionError: no such manager; the message lists those there are.
    """
    known = f"{', '.join((OURS, *MANAGERS))}; one of your own is given as package:Class"
    found = name if isinstance(name, type) else MANAGERS.find(name, known)
    if not (isinstance(found, type) and issubclass(found, Manager)):
        shown = name.__name__ if isinstance(name, type) else name
        raise MissionError(f"{shown!r} is no subclass of missions.baselines.Manager")
    return found


def name_of(manager: type[Manager]) -> str:
    own = f"{manager.__module__}:{manager.__qualname__}"
    return next((name for name, home in MANAGERS.homes.items() if home == own), own)


def options_of(manager: str | type[Manager]) -> tuple[Setting, ...]:
    """Return what can be set of a manager; nothing of ours."""
    return () if manager == OURS else find_manager(manager).options


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

    Raises:
        MissionError: no such manager, task layer or setting, or they do not go together.
    """
    import numpy

    check_task(task)
    managed_by = None if manager == OURS else find_manager(manager)
    options = options_of(manager)
    given, values = own_values(options, settings or {})
    run_settings, world_settings = split_settings(mission, values)
    rng = numpy.random.default_rng(seed)
    with needs("sim", f"the world of {mission.name}"):
        world = mission.world.open(world_settings, rng)
    if managed_by is None:
        return rosa_run(mission, task, world, run_settings, listeners)
    from missions.baselines.controller import BaselineController
    from missions.suave.world import Sea

    if not isinstance(world, Sea):
        raise MissionError(
            f"mission {mission.name} can be run with manager {OURS} only, as --task bt or --task pddl: "
            f"{name_of(managed_by)} commands the nodes of the sea's vehicle, and {mission.name} does not happen in the "
            "sea"
        )
    if task != "bt":
        raise MissionError(f"--task {task} is a task layer of ours; --manager {manager} comes without one")
    chosen = {one.name: one.default for one in options} | read_values(options, given)
    published = [one.name for one in options if one.is_published]
    name = name_of(managed_by)
    controller = BaselineController(mission, name, managed_by, world, rng.spawn(1)[0], chosen, published)
    return MissionRun(mission, controller, world, run_settings, listeners)
