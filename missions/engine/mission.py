"""What a mission is: its model, its task logic as a tree and as PDDL, its world; and finding it."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from importlib import import_module
from inspect import Parameter, signature
from operator import attrgetter
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Final, NamedTuple, TypeVar

from py_trees.behaviour import Behaviour
from py_trees.common import Status
from py_trees.trees import BehaviourTree

from kb import KnowledgeBase, KnowledgeBaseError, ManagedSystem, Model
from missions import SUMMARIES
from missions.engine.percepts import MISSION_STATUS as MISSION_STATUS
from missions.engine.percepts import Message as Message
from missions.engine.percepts import Percepts as Percepts
from missions.engine.settings import MissionError as MissionError
from missions.engine.settings import RunSettings, declared, near, read_values
from missions.engine.settings import Setting as Setting
from rosa_bt.exceptions import line_in_words
from rosa_pddl.domain import RosaPddlError

if TYPE_CHECKING:
    from numpy.random import Generator

T = TypeVar("T")


class Condition(Behaviour):
    """SUCCESS while a function returns true, else FAILURE."""

    def __init__(self, name: str, holds: Callable[[], bool]) -> None:
        super().__init__(name)
        self._holds = holds

    def update(self) -> Status:
        return Status.SUCCESS if self._holds() else Status.FAILURE


# ---------------------------------------------------------------- the world


@dataclass(frozen=True, slots=True)
class Sample:
    """What could be seen of the robot at one moment, for pictures.

    Attributes:
        time: [s].
        position: (x, y, z) [m], world frame, z up; NaN where it is not known.
        signals: further quantities by name, e.g. {"altitude [m]": 2.9}.
    """

    time: float
    position: tuple[float, float, float]
    signals: Mapping[str, float]


TIME_LIMIT: Final = "time_limit"
NO_SUCCESS: Final = ("not_found", "aborted", "ended_early")


class Verdict(NamedTuple):
    """How a mission ended.

    Attributes:
        outcome: a word, e.g. "inspected_all"; "time_limit" if as much was done as time allowed;
            "not_found", "aborted" and "ended_early" (short of the goal) are the only failures.
        detail: further text for the person at this machine; not part of the result.
    """

    outcome: str
    reason: str
    detail: str = ""

    @property
    def success(self) -> bool:
        """Whether the mission did what it was for."""
        return self.outcome not in NO_SUCCESS


class World(ABC):
    """Where a mission happens: a simulator, robot or recording.

    Only `now`, `managed` and `advance` are required. A run names the method that fails or returns
    something of the wrong type.
    """

    @property
    @abstractmethod
    def now(self) -> float:
        """The time [s]."""

    @property
    @abstractmethod
    def managed(self) -> ManagedSystem:
        """What switches and configures the components."""

    @abstractmethod
    def advance(self, until: float) -> list[Message]:
        """Let time pass until news is published, a command ends, or it is `until` [s]."""

    @property
    def is_still(self) -> bool:
        """Whether nothing that decisions depend on changes unless something is commanded."""
        return False

    def results(self) -> Mapping[str, float | None]:
        """Return the mission's figures up to now, units in the names; None: did not happen."""
        return {}

    def reactions(self) -> Sequence[Any]:
        """Return the reactions to uncertainties: objects with uncertainty, start_s and delay_s."""
        return ()

    def sample(self) -> Sample | None:
        """Return what can be seen now; None if that is only what the knowledge base knows."""
        return None

    def disturbances(self) -> list[tuple[float, str]]:
        """Return what truly happened, and when [s]."""
        return []

    def scenery(self) -> Mapping[str, Any]:
        """Return what a map of the place shows: arrays (n, 2) of x and y [m] by name."""
        return {}

    def close(self) -> None:  # noqa: B027  # most worlds have nothing to release
        """Release what the world uses."""


class WorldKind(ABC):
    """How a world is opened; what it needs is imported only then.

    Attributes:
        managers: managers that only this world has, as "package:Class" by name.
    """

    managers: ClassVar[Mapping[str, str]] = {}

    @abstractmethod
    def open(self, values: Mapping[str, Any], rng: "Generator") -> World:
        """Open a world with these settings; all its random numbers come from the generator."""

    @abstractmethod
    def verdict(
        self, percepts: Percepts, results: Mapping[str, float | None], kb: KnowledgeBase
    ) -> Verdict:
        """Judge a run by what was sensed, its figures and what was done.

        The caller finds out whether the task ended early.
        """

    def settings(self) -> tuple[Setting, ...]:
        """Return what can be set."""
        return ()


# ---------------------------------------------------------------- the mission


_PARAMETERS: Final = {
    "model": "",
    "tree": "kb, percepts",
    "facts": "kb, percepts",
    "why_not": "kb, percepts",
    "world.open": "values, rng",
    "world.verdict": "percepts, results, kb",
}


@dataclass(frozen=True)
class Mission:
    """One mission: of the registry, or of your own.

    Attributes:
        name: what it is called on the command line.
        summary: what happens in it, in a line.
        model: builds the model of the robot.
        tree: builds the task logic as a behaviour tree; None if the mission is planned only.
        world: where it happens.
        domain: PDDL file with the same task logic as actions; None for a mission with a tree only.
        problem: PDDL file with objects, facts and goal, or a function that returns its text.
        actions: by PDDL action, the behaviour that does it; the same as in the tree. One with a
            parameter `step` also receives the `rosa_pddl.Step` that it does.
        facts: returns what holds now, as in the PDDL problem: facts such as {"(lit room)": True},
            and numbers for costs such as {"(length a b)": 3.5}.
        engine: name of the planning engine, see `rosa_pddl.Planner`; None for the default.
        fixed: settings of the world that belong to this mission.
        why_not: returns why the goal cannot be reached, by what is known and was sensed; empty if
            it cannot tell. With a reason, the mission ends as soon as its world `is_still`.
        selects: whether the task layer selects configurations, so that only ours can manage it.

    Raises:
        MissionError: it has no world or no task, or a function has other parameters.
    """

    name: str
    summary: str
    model: Callable[[], Model]
    tree: Callable[[KnowledgeBase, Percepts], Behaviour] | None = None
    world: WorldKind = None  # type: ignore[assignment]  # refused below, with what to write instead
    domain: Path | None = None
    problem: Path | Callable[[], str] | None = None
    actions: Mapping[str, Callable[..., Behaviour]] = field(default_factory=dict)
    facts: Callable[[KnowledgeBase, Percepts], Mapping[str, bool | float]] = lambda kb, percepts: {}
    engine: str | None = None
    fixed: Mapping[str, str] = field(default_factory=dict)
    why_not: Callable[[KnowledgeBase, Percepts], str] = lambda kb, percepts: ""
    selects: bool = False

    def __post_init__(self) -> None:
        if not isinstance(self.world, WorldKind):
            expected = "expected is an object of a subclass of WorldKind"
            raise MissionError(f"world of mission {self.name} is {self.world!r}; {expected}")
        if self.tree is None and self.problem is None:
            hint = "give it a tree, or a PDDL domain and problem"
            raise MissionError(f"mission {self.name} has no task: {hint}")
        for name, parameters in _PARAMETERS.items():
            function = attrgetter(name)(self)
            try:
                if function is not None or name != "tree":
                    signature(function).bind(*parameters.split())
            except TypeError as error:
                title = f"{name} of mission {self.name} is called with ({parameters})"
                raise MissionError(
                    f"{title}: {error}; give a function of these parameters"
                ) from error


# ---------------------------------------------------------------- an author's code


@contextmanager
def blamed(what: Callable[[], str], *, is_authors: bool = True) -> Iterator[None]:
    """Turn an exception of an author's code into a MissionError that says what failed, and where.

    With `is_authors` false, the code inside is ours and may call an author's: an exception without
    a line of an author's code is ours, and stays as it is.
    """
    try:
        yield
    except (MissionError, KnowledgeBaseError, RosaPddlError):
        raise
    except Exception as error:
        line = line_in_words(error, "suave_env", "numpy", "mujoco")
        if not is_authors and not line:
            raise
        raise MissionError(f"{what()}: {type(error).__name__}: {error}{line}") from error


def built(title: str, kind: type[T], build: Callable[..., object], *arguments: object) -> T:
    """Call an author's function with as many of the arguments as it requires; check the result.

    Raises:
        MissionError: it fails, or the result is of another type. (Of a `BehaviourTree` the root is
            returned.)
    """
    with blamed(lambda: f"cannot build {title}"):
        parameters = signature(build).parameters.values() if arguments else ()
        places = [each for each in parameters if each.kind <= Parameter.POSITIONAL_OR_KEYWORD]
        required = [each for each in places if each.default is Parameter.empty]
        result = build(*arguments[: len(required)])
    if isinstance(result, BehaviourTree):
        result = result.root
    if not isinstance(result, kind):
        expected = "py_trees behaviour" if kind is Behaviour else kind.__name__
        raise MissionError(f"{title} is {result!r:.100}, not a {expected}")
    return result


def settings_of(mission: Mission) -> tuple[Setting, ...]:
    """Return all settings of a mission: those of the run, then those of its world."""
    with blamed(lambda: f"settings() of {type(mission.world).__name__} failed"):
        return (*declared(RunSettings), *mission.world.settings())


def split_settings(
    mission: Mission, values: Mapping[str, str], options: Sequence[Setting] = ()
) -> tuple[RunSettings, dict[str, Any], dict[str, Any]]:
    """Read settings, and split them into those of the run, of the world, and of a manager.

    The unit at the end of a name may be left out, as in start_y for start_y_m.

    Raises:
        MissionError: an unknown name or a value that is not allowed.
    """
    settings = (*options, *settings_of(mission))
    read = read_values(settings, mission.fixed, mission.name)
    read |= read_values(settings, values, mission.name)
    option_values = {option.name: read.pop(option.name, option.default) for option in options}
    names = [setting.name for setting in declared(RunSettings) if setting.name in read]
    run_settings = RunSettings(**{name: read.pop(name) for name in names})
    return run_settings, read, option_values


# ---------------------------------------------------------------- by name, imported when asked for

MISSIONS: Final = {name: f"missions.{name}:MISSION" for name in SUMMARIES}
"""Where each registered mission is defined."""
SEA_MANAGERS: Final = {
    "none": "missions.baselines.modes:NoManager",
    "random": "missions.baselines.modes:RandomManager",
    "bt": "missions.baselines.modes:TreeManager",
    "metacontrol": "missions.baselines.modes:Metacontrol",
    "rosa": "missions.baselines.rosa:RosaManager",
    "ahead": "missions.baselines.rosa:LookaheadManager",
}
"""Where the managers of the sea's vehicle are defined."""
_OWN: Final = f"{', '.join(MISSIONS)}; one of your own is "


def _advice(kind: str, name: str) -> str:
    """Return what to write instead of an unknown name, if it looks like something else."""
    if name.endswith(".toml"):
        return f"a file of settings is given as --config {name}; "
    if name.isidentifier() and (Path(name, "__init__.py").exists() or Path(f"{name}.py").exists()):
        return f"did you mean {name}:{kind.upper()}? "
    return ""


def load(kind: str, name: str, homes: Mapping[str, str], existing: str) -> Any:  # noqa: ANN401  # the caller checks it
    """Import a thing of some kind, such as "mission", by a registered name or as "module:NAME".

    `homes` has the "module:NAME" of each registered name; `existing` lists what there is, for the
    error message.

    Raises:
        MissionError: the name is unknown, or the import fails.
    """
    if name not in homes and ":" not in name[1:]:
        raise MissionError(f"unknown {kind} {name!r}; {_advice(kind, name)}there are {existing}")
    home, _, attribute = homes.get(name, name).partition(":")
    title = f"cannot import {kind} {name!r}"
    try:
        module = import_module(home)
    except Exception as error:  # an author's module may raise anything
        problem = f"{type(error).__name__}: {error}{line_in_words(error)}"
        if isinstance(error, ModuleNotFoundError) and error.name == home.partition(".")[0]:
            problem = f"there is no module {home} here in {Path.cwd()}, nor among what is installed"
        raise MissionError(f"{title}: {problem}") from error
    if not hasattr(module, attribute):
        close = near(attribute, vars(module)) or [name for name in vars(module) if name.isupper()]
        names = " or ".join(f"{home}:{name}" for name in close)
        hint = f"; did you mean {names}?" if close else ""
        raise MissionError(f"{title}: {home} has no {attribute!r}{hint}")
    return getattr(module, attribute)


def find_mission(name: str) -> Mission:
    """Return a mission by its registered name, or as "module:NAME" of any importable module.

    Raises:
        MissionError: no such mission; the message lists those there are.
    """
    mission = load("mission", name, MISSIONS, _OWN + "given as module:NAME")
    if not isinstance(mission, Mission):
        kind = type(mission).__name__
        raise MissionError(f"{name!r} is a {kind}, not a missions.engine.mission.Mission")
    return mission


def find_robot(name: str) -> tuple[Model, Mission | None]:
    """Return a robot's model, and its mission if it has one.

    The name is that of a mission or a model file, or module:NAME.

    Raises:
        MissionError, KnowledgeBaseError: there is no such thing, or it cannot be read or built.
    """
    if Path(name).suffix in (".tql", ".owl"):
        return Model.load(name), None
    robot = load("mission", name, MISSIONS, _OWN + "a file (.tql, .owl) or module:NAME")
    if isinstance(robot, Mission):
        return robot.model(), robot
    if isinstance(robot, Model):
        return robot, None
    if not callable(robot):
        raise MissionError(
            f"{name!r} is no mission, no model and no function that makes one, but {robot!r:.80}"
        )
    return built(name, Model, robot), None


@contextmanager
def needs(extra: str, what: str) -> Iterator[None]:
    """Name the extra to install when an import inside the block fails.

        with needs("live", "the live page"):
            import websockets

    Raises:
        MissionError: a library is not installed.
    """
    try:
        yield
    except ImportError as error:
        missing = f"{what} needs {error.name or error}, which is not installed"
        raise MissionError(f"{missing}; pip install 'rosa-taca[{extra}]' brings it") from error
