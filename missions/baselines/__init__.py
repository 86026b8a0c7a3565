"""The managers of a robot in a run: ours, those that it is compared with, and your own; and how to open a run."""

from collections.abc import Mapping
from functools import partial
from typing import Any, Final

from missions.baselines.manager import BaselineRun, Manager, Robot
from missions.baselines.policies import ByHand, Policy
from missions.engine.mission import (
    Mission,
    MissionError,
    World,
    blamed,
    built,
    load,
    needs,
    split_settings,
)
from missions.engine.runner import OURS, MissionRun, RosaRun
from missions.engine.settings import Setting
from missions.engine.task_layer import TASK_KINDS, check_task

__all__ = [
    "MANAGERS",
    "Manager",
    "OURS",
    "POLICIES",
    "Policy",
    "Robot",
    "Setting",
    "find_manager",
    "open_run",
]

MANAGERS: Final = {
    "none": "missions.baselines.modes:NoManager",
    "random": "missions.baselines.modes:RandomManager",
    "bt": "missions.baselines.modes:TreeManager",
    "metacontrol": "missions.baselines.modes:Metacontrol",
    "rosa": "missions.baselines.rosa:RosaManager",
    "ahead": "missions.baselines.rosa:AheadManager",
}
"""The managers of the sea's vehicle, except ours, each with its module and class."""

POLICIES: Final = {
    "none": "missions.baselines.policies:Unmanaged",
    "random": "missions.baselines.policies:Random",
    "fixed": "missions.baselines.policies:Fixed",
    "bt": "missions.baselines.policies:ByHand",
}
"""The managers of every other mission; the sea has those that `MANAGERS` does not replace."""

AnyManager = type[Manager] | type[Policy]


def find_manager(name: str | AnyManager, mission: Mission) -> AnyManager:
    """Return the class of a manager, given by its name, by "package:Class", or as the class itself.

    Raises:
        MissionError: no such manager, or it does not go with the mission; the message lists those that exist.
    """
    in_sea = _is_in_sea(mission)
    if isinstance(name, type):
        found: Any = name
    else:
        homes = POLICIES | (MANAGERS if in_sea else {})
        where = (
            f"; {name} manages the vehicle of the sea only"
            if name in MANAGERS and name not in homes
            else ""
        )
        known = f"{', '.join((OURS, *homes))}; one of your own is given as package:Class{where}"
        found = load("manager", name, homes, known)
    if not (isinstance(found, type) and issubclass(found, Manager | Policy)):
        shown = getattr(name, "__name__", name)
        raise MissionError(f"{shown!r} is no subclass of missions.baselines.Policy or Manager")
    if issubclass(found, Manager) and not in_sea:
        what = f"{found.__name__} commands the sea's vehicle, and {mission.name} does not happen in the sea"
        raise MissionError(f"{what}; make it a subclass of missions.baselines.Policy")
    if mission.selects:
        raise MissionError(
            f"the task layer of mission {mission.name} selects configurations; run it under {OURS}"
        )
    return found


def _is_in_sea(mission: Mission) -> bool:
    from missions.suave.world import SEA  # no other mission imports that

    return isinstance(mission.world, type(SEA))


def name_of(manager: AnyManager) -> str:
    own = f"{manager.__module__}:{manager.__qualname__}"
    return next((name for name, home in (*MANAGERS.items(), *POLICIES.items()) if home == own), own)


def options_of(manager: str | AnyManager, mission: Mission) -> tuple[Setting, ...]:
    """Return the options of a manager; ours has none."""
    return () if manager == OURS else find_manager(manager, mission).options


def open_run(
    mission: Mission,
    *,
    manager: str | AnyManager = OURS,
    task: str | None = None,
    seed: int = 0,
    settings: Mapping[str, str] | None = None,
) -> MissionRun:
    """Open a run; the same mission, seed and settings give the same world and chance under every manager.

    Args:
        mission: what to run.
        manager: the name of a manager, "package:Class", or the class itself.
        task: our task layer, "bt" or "pddl", by default the mission's; some managers bring their own.
        seed: seed of all chance in the run.
        settings: values that differ from the defaults, by name; a unit at the end of a name may be left out.

    Raises:
        MissionError: no such manager, task layer or setting, or they do not go together.
    """
    import numpy

    managed_by, task = check_run(mission, manager, task)
    options = () if managed_by is None else managed_by.options
    run_settings, world_settings, chosen = split_settings(mission, settings or {}, options)
    rng = numpy.random.default_rng(seed)

    def opened() -> object:
        with needs("sim", f"the world of {mission.name}"):
            return mission.world.open(world_settings, rng)

    world = built(f"what open() of {type(mission.world).__name__} gives", World, opened)  # type: ignore[type-abstract]  # only for isinstance
    name = OURS if managed_by is None else name_of(managed_by)
    try:
        with blamed(lambda: f"mission {mission.name} under manager {name}", is_authors=False):
            if managed_by is None:
                return RosaRun(mission, task, world, run_settings)
            chance = rng.spawn(1)[0]
            if issubclass(managed_by, Policy):
                policy = managed_by(mission.model(), chance, chosen)
                mission = built(
                    f"what alter() of {name} gives", Mission, partial(policy.alter, mission, world)
                )
                return RosaRun(mission, task, world, run_settings, name, policy, policy.hear)
            return BaselineRun(mission, world, run_settings, name, managed_by, chance, chosen)  # type: ignore[arg-type]  # a Manager's world is the Sea
    except BaseException:
        world.close()
        raise


def check_run(
    mission: Mission, manager: str | AnyManager, task: str | None
) -> tuple[AnyManager | None, str]:
    """Return the manager (None for ours) and the task layer; MissionError unless both go with the mission."""
    managed_by = None if manager == OURS else find_manager(manager, mission)
    if managed_by is not None and issubclass(managed_by, ByHand) and mission.by_hand is None:
        advice = "give it by_hand=lambda kb, percepts, managed: ..., or take another manager"
        raise MissionError(f"mission {mission.name} has no hand-written tree; {advice}")
    tasks = TASK_KINDS if managed_by is None else managed_by.tasks
    task = task or tasks[-1 if mission.tree is None else 0]
    check_task(task)
    if task not in tasks:
        raise MissionError(
            f"--task {task} is a task layer of ours; --manager {manager} comes without one"
        )
    return managed_by, task
