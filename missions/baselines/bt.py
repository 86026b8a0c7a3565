"""The behaviour tree of SUAVE, which decides about tasks and adapts the vehicle, both in one tree.

The tree is that of kas-lab/suave v1.3.0 (suave_bt) and of its extended mission:

mission (reactive)
├── motion: all thrusters ok? -> mode fd_all_thrusters, or else mode fd_recover_thrusters
└── work or recharge
    ├── work (reactive)
    │   ├── battery ok?                                        extended mission only
    │   ├── find: found?, or else (altitude by visibility -> search)
    │   └── mode fd_follow_pipeline -> inspect
    └── unground search and inspection -> mode normal -> recharge -> mode inactive
"""

import numpy as np
from py_trees.behaviour import Behaviour
from py_trees.common import Status
from py_trees.composites import Selector, Sequence

from missions.baselines.manager import Manager, Robot
from missions.baselines.modes import SystemModes
from missions.engine.mission import Condition

SEARCH, FOLLOW, MOTION = "f_generate_search_path", "f_follow_pipeline", "f_maintain_motion"
RECHARGE = "f_generate_recharge_path"
LOW_LEVEL = np.float32(0.25)


class TreeManager(Manager):
    """Ticks the tree every 0.15 s; it sleeps for 100 ms after each tick and for 50 ms in each running action."""

    decides_tasks = True

    def __init__(self, robot: Robot) -> None:
        super().__init__(robot)
        self.period_s = robot.settings.tree_period_s
        self.root = _tree(robot, SystemModes(robot))

    @property
    def is_done(self) -> bool:
        return self.robot.percepts.count("pipeline_inspected") > 0

    def update(self) -> None:
        self.root.tick_once()


class _RequestMode(Behaviour):
    """Asks for a mode, unless it was asked for already; succeeds at once."""

    def __init__(self, modes: SystemModes, function: str, mode: str) -> None:
        super().__init__(f"{function}: {mode}")
        self._modes, self._function, self._mode = modes, function, mode

    def update(self) -> Status:
        self._modes.request(self._function, self._mode)
        return Status.SUCCESS


class _DoTask(Behaviour):
    """Does a task until something was published once more; then, or when it is halted, functions are ungrounded."""

    def __init__(self, robot: Robot, modes: SystemModes, task: str, until: str, functions: tuple[str, ...]) -> None:
        super().__init__(task)
        self._robot, self._modes, self._task, self._until, self._functions = robot, modes, task, until, functions
        self._before = 0

    def initialise(self) -> None:
        self._robot.begin(self._task)
        self._before = self._robot.percepts.count(self._until)

    def update(self) -> Status:
        return Status.SUCCESS if self._robot.percepts.count(self._until) > self._before else Status.RUNNING

    def terminate(self, new_status: Status) -> None:
        if self.status is Status.RUNNING or new_status is Status.SUCCESS:
            self._robot.end("completed" if new_status is Status.SUCCESS else "abandoned")
            for function in self._functions:
                self._modes.unground(function)


def _tree(robot: Robot, modes: SystemModes) -> Behaviour:
    def request(function: str, mode: str) -> Behaviour:
        return _RequestMode(modes, function, mode)

    def do(task: str, until: str, *functions: str) -> Behaviour:
        return _DoTask(robot, modes, task, until, functions)

    def sequence(name: str, *children: Behaviour, memory: bool = False) -> Behaviour:
        return Sequence(name, memory=memory, children=list(children))

    def selector(name: str, *children: Behaviour, memory: bool = False) -> Behaviour:
        return Selector(name, memory=memory, children=list(children))

    def altitude(mode: str, least_m: float) -> Behaviour:
        clear = Condition(f"visibility >= {least_m} m?", lambda: robot.measured.get("water_visibility", 9.0) >= least_m)
        return sequence(mode, clear, request(SEARCH, mode))

    motion = selector(
        "motion",
        sequence(
            "thrusters ok",
            Condition("all thrusters ok?", lambda: {"RECOVERED", "OK"}.issuperset(robot.reported.values())),
            request(MOTION, "fd_all_thrusters"),
        ),
        request(MOTION, "fd_recover_thrusters"),
    )
    search = sequence(
        "search",
        selector(
            "altitude",
            altitude("fd_spiral_high", 3.25),
            altitude("fd_spiral_medium", 2.25),
            altitude("fd_spiral_low", 1.25),
        ),
        do("search_pipeline", "pipeline_found", SEARCH),
    )
    work = sequence(
        "work",
        Condition("battery ok?", lambda: bool(np.float32(robot.measured.get("battery_level", 1.0)) >= LOW_LEVEL)),
        selector("find", Condition("found?", lambda: robot.percepts.count("pipeline_found") > 0), search, memory=True),
        sequence(
            "inspect", request(FOLLOW, "fd_follow_pipeline"), do("inspect_pipeline", "pipeline_inspected", FOLLOW)
        ),
    )
    recharge = sequence(
        "recharge",
        request(SEARCH, "fd_unground"),
        request(FOLLOW, "fd_unground"),
        request(RECHARGE, "normal"),
        do("recharge", "battery_recharged"),
        request(RECHARGE, "inactive"),
        memory=True,
    )
    return sequence("mission", motion, selector("work or recharge", work, recharge, memory=True))
