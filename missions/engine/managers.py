"""Open a run of a mission under a manager: ours, one that it is compared with, or your own."""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, ClassVar, Final

from missions.engine.mission import Mission, World, blamed, built, load, needs, split_settings
from missions.engine.runner import OURS, MissionRun, RosaRun
from missions.engine.settings import MissionError, RunSettings, Setting
from missions.engine.task_layer import TASK_KINDS, check_task

if TYPE_CHECKING:
    from numpy.random import Generator

SEA_MANAGERS: Final = {
    "none": "missions.baselines.modes:NoManager",
    "random": "missions.baselines.modes:RandomManager",
    "bt": "missions.baselines.modes:TreeManager",
    "metacontrol": "missions.baselines.modes:Metacontrol",
    "rosa": "missions.baselines.rosa:RosaManager",
    "ahead": "missions.baselines.rosa:LookaheadManager",
}
"""Where the managers of the sea's vehicle are defined, except ours."""

POLICIES: Final = {
    "none": "missions.baselines.policies:Unmanaged",
    "random": "missions.baselines.policies:Random",
    "fixed": "missions.baselines.policies:Fixed",
    "bt": "missions.baselines.policies:ByHand",
}
"""Where the managers of every other mission are defined; in the sea, `SEA_MANAGERS` go first."""


class ManagerBase(ABC):
    """What every manager declares, and how a run under it is opened.

    Attributes:
        tasks: names of the task layers that it goes with.
        options: settings of the manager that can be set from outside.
    """

    tasks: ClassVar[tuple[str, ...]] = TASK_KINDS
    options: ClassVar[tuple[Setting, ...]] = ()

    @classmethod
    def refusal(cls, mission: Mission) -> str:
        """Return why this manager cannot manage a mission; empty if it can."""
        return ""

    @classmethod
    @abstractmethod
    def open(
        cls,
        mission: Mission,
        task: str,
        world: World,
        settings: RunSettings,
        rng: "Generator",
        options: Mapping[str, Any],
    ) -> MissionRun:
        """Return a run of the mission in this world, with values of all options by name."""


ManagerType = type[ManagerBase]


def find_manager(name: str | ManagerType, mission: Mission) -> ManagerType:
    """Return the class of a manager by its name, by "package:Class", or as the class itself.

    Raises:
        MissionError: no such manager, or it does not go with the mission; lists those that exist.
    """
    manager: Any = name
    if isinstance(name, str):
        homes = POLICIES | (SEA_MANAGERS if is_in_sea(mission) else {})
        existing = f"{', '.join((OURS, *homes))}; one of your own is given as package:Class"
        if name in SEA_MANAGERS and name not in homes:
            existing += f"; {name} manages the vehicle of the sea only"
        manager = load("manager", name, homes, existing)
    if not (isinstance(manager, type) and issubclass(manager, ManagerBase)):
        title = getattr(name, "__name__", name)
        raise MissionError(f"{title!r} is no subclass of missions.baselines.Policy or Manager")
    refusal = manager.refusal(mission)
    if mission.selects:
        title = f"the task layer of mission {mission.name}"
        refusal = f"{title} selects configurations; run it under {OURS}"
    if refusal:
        raise MissionError(refusal)
    return manager


def is_in_sea(mission: Mission) -> bool:
    """Return whether a mission happens in the sea of SUAVE."""
    from missions.suave.world import SEA  # no other mission imports that

    return isinstance(mission.world, type(SEA))


def manager_name(manager: ManagerType) -> str:
    """Return the registered name of a manager, else "package:Class"."""
    home = f"{manager.__module__}:{manager.__qualname__}"
    names = {home: name for homes in (POLICIES, SEA_MANAGERS) for name, home in homes.items()}
    return names.get(home, home)


def options_of(manager: str | ManagerType, mission: Mission) -> tuple[Setting, ...]:
    """Return the options of a manager; ours has none."""
    return () if manager == OURS else find_manager(manager, mission).options


def open_run(
    mission: Mission,
    *,
    manager: str | ManagerType = OURS,
    task: str | None = None,
    seed: int = 0,
    settings: Mapping[str, str] | None = None,
) -> MissionRun:
    """Open a run; the same mission, seed and settings give the same world under every manager.

    Args:
        mission: what to run.
        manager: the name of a manager, "package:Class", or the class itself.
        task: our task layer, "bt" or "pddl", by default the mission's; some managers have none.
        seed: seed of all chance in the run.
        settings: values that differ from the defaults; a unit at the end of a name may be left out.

    Raises:
        MissionError: no such manager, task layer or setting, or they do not go together.
    """
    import numpy

    manager_type = None if manager == OURS else find_manager(manager, mission)
    tasks = TASK_KINDS if manager_type is None else manager_type.tasks
    if task is None:
        task = tasks[-1 if mission.tree is None else 0]
    check_task(task)
    if task not in tasks:
        raise MissionError(
            f"--task {task} is a task layer of ours; --manager {manager} comes without one"
        )
    options = () if manager_type is None else manager_type.options
    run_settings, world_settings, values = split_settings(mission, settings or {}, options)
    rng = numpy.random.default_rng(seed)

    def open_world() -> object:
        with needs("sim", f"the world of {mission.name}"):
            return mission.world.open(world_settings, rng)

    title = f"what open() of {type(mission.world).__name__} gives"
    world = built(title, World, open_world)  # type: ignore[type-abstract]  # only for isinstance
    name = OURS if manager_type is None else manager_name(manager_type)
    try:
        with blamed(lambda: f"mission {mission.name} under manager {name}", is_authors=False):
            if manager_type is None:
                return RosaRun(mission, task, world, run_settings)
            chance = rng.spawn(1)[0]
            return manager_type.open(mission, task, world, run_settings, chance, values)
    except BaseException:
        world.close()
        raise
