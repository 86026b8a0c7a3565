"""What a mission is: its model, its task logic as a tree and as PDDL, its world, and how it is found by its name."""

from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from importlib import import_module
from inspect import Parameter, signature
from math import inf
from numbers import Real
from operator import attrgetter
from pathlib import Path
from traceback import extract_tb
from typing import TYPE_CHECKING, Any, Final, NamedTuple, Protocol, TypeVar

from py_trees.behaviour import Behaviour
from py_trees.common import Status
from py_trees.trees import BehaviourTree

from kb import KnowledgeBase, KnowledgeBaseError, ManagedSystem, Model
from missions import SUMMARIES
from missions.engine.settings import MissionError as MissionError
from missions.engine.settings import RunSettings, declared, full_names, near, read_values
from missions.engine.settings import Setting as Setting
from rosa_bt.exceptions import line_in_words
from rosa_pddl.exceptions import RosaPddlError

if TYPE_CHECKING:
    from numpy.random import Generator


T = TypeVar("T")

Message = Mapping[str, Any]
"""Diagnostics as they travel: `{"time": s, "status": [{"name": ..., "message": ..., "values": {...}}, ...]}`."""

NUMBER: Final = (float, int, Real)
"""What counts as a number that a world gives; the usual types come first, as that is quickest."""
_OBJECT: Final = (dict, Mapping)


def check_message(message: Any, where: str) -> None:  # noqa: ANN401  # it may be anything before it is checked
    """Check that this is diagnostics as they travel; MissionError if not, which names where it is from."""
    said: Any = message if isinstance(message, _OBJECT) else {}
    time, statuses = said.get("time"), said.get("status")
    if not isinstance(time, NUMBER) or isinstance(time, bool) or not 0 <= float(time) < inf:
        wanted = 'a message is an object with a number "time" [s] from 0 and a list "status"'
        raise MissionError(f"{where}: {wanted}, not {message!r:.100}")
    for one in statuses if isinstance(statuses, list | tuple) else (statuses,):
        values = one.get("values") if isinstance(one, _OBJECT) else None
        if not isinstance(values, _OBJECT) or not isinstance(one.get("message"), str):
            wanted = 'each "status" is an object with a text "message" and an object "values"'
            raise MissionError(f"{where}: {wanted}, not {one!r:.100}")
        for name in values:
            if not isinstance(name, str):
                raise MissionError(f'{where}: the names in "values" are texts, not {name!r:.100}')


MISSION_STATUS: Final = "mission status"


class Percepts:
    """Receives the same messages as the knowledge base and keeps the statuses with the text "mission status".

    The knowledge base ignores these; a mission's conditions look at them, e.g. whether something is found.

    Attributes:
        revision: how many such statuses were received; while it stays the same, so does all that was sensed.
    """

    def __init__(self) -> None:
        self._said: dict[str, str] = {}
        self._times: Counter[str] = Counter()
        self.revision = 0

    def receive(self, message: Mapping[str, Any]) -> Sequence[str]:
        """Take in one message: `{"time": ..., "status": [{"message": ..., "values": {...}}, ...]}`.

        Returns:
            The keys that hold now and did not before, or the other way round.
        """
        held: dict[str, bool] = {}
        for status in message["status"]:
            if str(status["message"]).casefold() == MISSION_STATUS:
                self.revision += 1
                for key, value in status["values"].items():
                    held.setdefault(key, self.holds(key))
                    self._said[key] = str(value)
                    self._times[key] += 1
        return [key for key, before in held.items() if self.holds(key) is not before]

    def holds(self, key: str) -> bool:
        """Return whether the last value of a key was "true"; False if it was never received."""
        return self._said.get(key, "").casefold() == "true"

    def value(self, key: str) -> float | None:
        """Return the last value of a key as a number; None if it is no number or was never received."""
        try:
            return float(self._said[key])
        except (KeyError, ValueError):
            return None

    def count(self, key: str) -> int:
        """Return how often a key was received."""
        return self._times[key]


class Condition(Behaviour):
    """SUCCESS while a function returns true, else FAILURE."""

    def __init__(self, name: str, holds: Callable[[], bool]) -> None:
        super().__init__(name)
        self._holds = holds

    def update(self) -> Status:
        return Status.SUCCESS if self._holds() else Status.FAILURE


class Reaction(Protocol):
    """A reaction to an uncertainty: its name, when it was reported first, and when the reaction was in force [s]."""

    @property
    def uncertainty(self) -> str: ...
    @property
    def start_s(self) -> float: ...
    @property
    def end_s(self) -> float: ...
    @property
    def delay_s(self) -> float: ...


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
        outcome: a word, e.g. "inspected_all"; "time_limit" for what was done as well as time allowed; "not_found",
            "aborted" and "ended_early" (the task ended short of the goal) are no successes, all others are.
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
    """Where a mission happens: a simulator, robot or recording. Only `now`, `managed` and `advance` are required.

    A run checks what these methods give, and says which one gives something else.
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
        """Let time pass until news is published, a command ends, or it is `until` [s]; return a list of messages."""

    @property
    def is_still(self) -> bool:
        """Whether nothing that decisions depend on changes any more unless something is commanded."""
        return False

    def results(self) -> Mapping[str, float | None]:
        """Return the mission's figures up to now by name, units in the names; None for what did not happen."""
        return {}

    def reactions(self) -> Sequence[Reaction]:
        """Return the reactions to uncertainties, in the order of their ends."""
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

    def close(self) -> None:  # noqa: B027  # a world that holds nothing has nothing to release
        """Release what the world holds."""


class WorldKind(ABC):
    """How a world is opened; what it needs is imported only then."""

    @abstractmethod
    def open(self, values: Mapping[str, str], rng: "Generator") -> World:
        """Open a world with these settings; all its random numbers come from the generator.

        Raises:
            MissionError: an unknown setting or a value that is not allowed.
        """

    @abstractmethod
    def verdict(
        self, percepts: Percepts, results: Mapping[str, float | None], kb: KnowledgeBase
    ) -> Verdict:
        """Return whether the goal of a mission is reached, or else what was not done in time.

        Judge it by what was sensed, the figures and what was done. The caller finds out whether the task ended early.
        """

    def settings(self) -> tuple[Setting, ...]:
        """Return what can be set."""
        return ()


_CALLED: Final = {  # the arguments of each function of a mission; tree and by_hand may be None
    **{
        "model": "",
        "tree": "kb, percepts",
        "by_hand": "kb, percepts, managed",
        "facts": "kb, percepts",
    },
    **{
        "why_not": "kb, percepts",
        "world.open": "values, rng",
        "world.verdict": "percepts, results, kb",
    },
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
        actions: by PDDL action, the behaviour that does it; the same as in the tree. One with a parameter `step` is also given the `rosa_pddl.Step` that it does.
        facts: returns what holds now, by what is known and was sensed, as in the PDDL problem: facts such as
            {"(lit room)": True}, and numbers for costs such as {"(length a b)": 3.5}.
        engines: names of planning engines, see `rosa_pddl.Planner`: the first one plans, the others if it fails;
            empty for the default.
        fixed: settings of the world that belong to this mission.
        why_not: returns why the goal cannot be reached, by what is known and was sensed; empty if it cannot tell.
            If it returns a reason, the mission ends as soon as its world `is_still`.
        by_hand: builds a tree that commands the managed system itself, for comparison: `--manager bt`.
        selects: whether the task layer selects configurations itself, so that no other manager can run it.

    Raises:
        MissionError: a field has the wrong type, a function takes other arguments, or there is no task.
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
    engines: tuple[str, ...] = ()
    fixed: Mapping[str, str] = field(default_factory=dict)
    why_not: Callable[[KnowledgeBase, Percepts], str] = lambda kb, percepts: ""
    by_hand: Callable[[KnowledgeBase, Percepts, ManagedSystem], Behaviour] | None = None
    selects: bool = False

    def __post_init__(self) -> None:
        self._check(
            "world", isinstance(self.world, WorldKind), "an object of a subclass of WorldKind"
        )
        self._check(
            "actions", isinstance(self.actions, Mapping), "a mapping of PDDL actions to behaviours"
        )
        self._check("domain", not isinstance(self.domain, str), "a pathlib.Path")
        self._check("problem", not isinstance(self.problem, str), "a pathlib.Path")
        self._check("engines", not isinstance(self.engines, str), "a tuple of names")
        for name, arguments in _CALLED.items():
            if (given := attrgetter(name)(self)) is not None or name not in ("tree", "by_hand"):
                self._check(name, callable(given), "a function")
                self._check_call(name, given, arguments)
        if self.tree is None and self.problem is None:
            raise MissionError(
                f"mission {self.name} has no task: give it a tree, or a PDDL domain and problem"
            )

    def _check(self, name: str, is_fit: bool, expected: str) -> None:
        if not is_fit:
            raise MissionError(
                f"{name} of mission {self.name} is {getattr(self, name)!r}; expected is {expected}"
            )

    def _check_call(self, name: str, given: Callable[..., object], arguments: str) -> None:
        with suppress(
            ValueError
        ):  # one that was not written in Python may not say how it is called
            takes = signature(given)
            try:
                takes.bind(*arguments.split())
            except TypeError as error:
                called = (
                    f"{name} of mission {self.name} is called with ({arguments}), but takes {takes}"
                )
                raise MissionError(f"{called}: {error}; give it these parameters") from error


@contextmanager
def blamed(what: Callable[[], str], *, is_authors: bool = True) -> Iterator[None]:
    """Turn exceptions of an author's code that are not ours into a MissionError that says what failed.

    With `is_authors` false, the code inside is ours and may call an author's; what raises there alone stays as it is.
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


def built(title: str, kind: type[T], build: Callable[..., object], *given: object) -> T:
    """Call a function of an author with as many of these arguments as it requires, and return what it makes.

    Raises:
        MissionError: it fails, or makes something of another type. (Of a `BehaviourTree` the root is returned.)
    """
    with blamed(lambda: f"cannot build {title}"):
        parameters = signature(build).parameters.values() if given else ()
        places = [
            one.default
            for one in parameters
            if one.kind in (one.POSITIONAL_ONLY, one.POSITIONAL_OR_KEYWORD)
        ]
        made = build(*given[: places.count(Parameter.empty)])
    made = made.root if isinstance(made, BehaviourTree) else made
    if not isinstance(made, kind):
        wanted = "py_trees behaviour" if kind is Behaviour else kind.__name__
        raise MissionError(f"{title} is {made!r:.100}, not a {wanted}")
    return made


def settings_of(mission: Mission) -> tuple[Setting, ...]:
    """Return all settings of a mission: those of the run, then those of its world."""
    its = f"settings() of {type(mission.world).__name__}"
    with blamed(lambda: f"{its} failed"):
        own = tuple(mission.world.settings())
    for one in own:
        if not isinstance(one, Setting):
            raise MissionError(
                f"{its} gives {one!r:.100}; expected is a tuple of missions.engine.settings.Setting"
            )
    return (*declared(RunSettings), *own)


def split_settings(
    mission: Mission, values: Mapping[str, str], options: Sequence[Setting] = ()
) -> tuple[RunSettings, dict[str, str], dict[str, Any]]:
    """Split settings into those of the run, of the world (which checks them), and options of a manager.

    Settings are given by name; the unit at the end may be left out, as in start_y for start_y_m.

    Raises:
        MissionError: an unknown name or a value that is not allowed.
    """
    of_run, known = declared(RunSettings), (*options, *settings_of(mission))
    chosen = full_names(known, mission.fixed, mission.name) | full_names(
        known, values, mission.name
    )
    run, world, own = (
        {one.name: chosen[one.name] for one in some if one.name in chosen}
        for some in (of_run, known[len(options) + len(of_run) :], options)
    )
    return (
        RunSettings.read(run),
        world,
        {one.name: one.default for one in options} | read_values(options, own),
    )


# -------------------------------------------------------------------- by name, and imported when asked for

MISSIONS: Final = {name: f"missions.{name}:MISSION" for name in SUMMARIES}
"""The registered missions, by name: where each is defined."""


def _advice(kind: str, name: str) -> str:
    """Return what to write instead of a name that is no registered one; empty if nothing is like it."""
    if name.endswith(".toml"):
        return f"a file of settings is given as --config {name}; "
    is_module = name.isidentifier() and (
        Path(name, "__init__.py").exists() or Path(f"{name}.py").exists()
    )
    return f"did you mean {name}:{kind.upper()}? " if is_module else ""


def load(kind: str, name: str, homes: Mapping[str, str], known: str) -> Any:  # noqa: ANN401  # whoever asks checks it
    """Import a thing of some kind, such as "mission", by a registered name or as "module:NAME".

    `homes` has the "module:NAME" of each registered name; `known` lists what exists, for the error message.

    Raises:
        MissionError: the name is unknown, or the import fails.
    """
    if name not in homes and ":" not in name[1:]:
        raise MissionError(f"unknown {kind} {name!r}; {_advice(kind, name)}there are {known}")
    module, _, attribute = homes.get(name, name).partition(":")
    try:
        found = import_module(module)
        if not hasattr(found, attribute):
            close = near(attribute, vars(found)) or [one for one in vars(found) if one.isupper()]
            did = (
                f"; did you mean {' or '.join(f'{module}:{one}' for one in close)}?"
                if close
                else ""
            )
            raise MissionError(f"{module} has no {attribute!r}{did}")
        return getattr(found, attribute)
    except Exception as error:  # an author's module may raise anything
        said = str(error) if isinstance(error, MissionError) else f"{type(error).__name__}: {error}"
        if isinstance(error, ModuleNotFoundError) and error.name == module.partition(".")[0]:
            said = f"there is no module {module} here in {Path.cwd()}, nor among what is installed"
        files = tuple(f"/{module.replace('.', '/')}{end}" for end in (".py", "/__init__.py"))
        places = [one for one in extract_tb(error.__traceback__) if one.filename.endswith(files)]
        where = "".join(f" ({Path(one.filename).name}, line {one.lineno})" for one in places[-1:])
        raise MissionError(f"cannot import {kind} {name!r}: {said}{where}") from error


def find_mission(name: str) -> Mission:
    """Return a mission by its registered name, or as "module:NAME" of any module that can be imported.

    Raises:
        MissionError: no such mission; the message lists those there are.
    """
    found = load(
        "mission", name, MISSIONS, f"{', '.join(MISSIONS)}; one of your own is given as module:NAME"
    )
    if not isinstance(found, Mission):
        raise MissionError(
            f"{name!r} is a {type(found).__name__}, not a missions.engine.mission.Mission"
        )
    return found


def find_robot(name: str) -> tuple[Model, Mission | None]:
    """Return the model of a robot, and its mission if it has one, by a mission's name, a model file or module:NAME.

    Raises:
        MissionError, KnowledgeBaseError: there is no such thing, or it cannot be read or made.
    """
    if Path(name).suffix in (".tql", ".owl"):
        return Model.load(name), None
    own = "one of your own is a file (.tql, .owl) or module:NAME"
    found = load("mission", name, MISSIONS, f"{', '.join(MISSIONS)}; {own}")
    if isinstance(found, Mission):
        return found.model(), found
    if not (isinstance(found, Model) or callable(found)):
        raise MissionError(
            f"{name!r} is no mission, no model and no function that makes one, but {found!r:.80}"
        )
    return found if isinstance(found, Model) else built(name, Model, found), None


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
