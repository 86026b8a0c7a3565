"""What is imported only when it is asked for: missions and the like, by name, and libraries that may be missing."""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from importlib import import_module
from pathlib import Path
from traceback import extract_tb
from typing import Any, TypeVar

from kb import Model
from missions.engine.mission import Mission, MissionError, built
from missions.engine.settings import near

T = TypeVar("T")


class Registry(Mapping[str, T]):
    """Things of a kind, such as "mission", by name; each is imported from its home, "module:NAME", when looked up."""

    def __init__(self, kind: str, homes: Mapping[str, str]) -> None:
        self.kind, self.homes = kind, homes

    def __getitem__(self, name: str) -> T:
        found: T = self._imported(name, self.homes[name])
        return found

    def __iter__(self) -> Iterator[str]:
        return iter(self.homes)

    def __len__(self) -> int:
        return len(self.homes)

    def __contains__(self, name: object) -> bool:
        return name in self.homes

    def find(self, name: str, known: str) -> Any:  # noqa: ANN401  # whoever asks checks what it is
        """Return one of them, or what "module:NAME" is, from anywhere that Python imports from.

        Raises:
            MissionError: there is no such thing; the message says what is `known`.
        """
        if name in self.homes:
            return self[name]
        if ":" not in name[1:]:
            raise MissionError(f"unknown {self.kind} {name!r}; there are {known}")
        return self._imported(name, name)

    def _imported(self, name: str, home: str) -> Any:  # noqa: ANN401  # whatever a registry holds
        module, _, attribute = home.partition(":")
        try:
            found = import_module(module)
            if not hasattr(found, attribute):
                close = near(attribute, vars(found)) or [one for one in vars(found) if one.isupper()]
                did = f"; did you mean {' or '.join(f'{module}:{one}' for one in close)}?" if close else ""
                raise MissionError(f"{module} has no {attribute!r}{did}")
            return getattr(found, attribute)
        except Exception as error:  # whatever an author's module may raise
            said = str(error) if isinstance(error, MissionError) else f"{type(error).__name__}: {error}"
            if isinstance(error, ModuleNotFoundError) and error.name == module.partition(".")[0]:
                said = f"there is no module {module} here in {Path.cwd()}, nor among what is installed"
            files = tuple(f"/{module.replace('.', '/')}{end}" for end in (".py", "/__init__.py"))
            places = [one for one in extract_tb(error.__traceback__) if one.filename.endswith(files)]
            where = "".join(f" ({Path(one.filename).name}, line {one.lineno})" for one in places[-1:])
            raise MissionError(f"cannot import {self.kind} {name!r}: {said}{where}") from error


_NAMES = ("suave", "suave_extended", "agv", "uav")
MISSIONS = Registry[Mission]("mission", {name: f"missions.{name}:MISSION" for name in _NAMES})


def find_mission(name: str) -> Mission:
    """Return a mission by its name in the registry, or as "module:NAME" from anywhere that Python imports from.

    Raises:
        MissionError: no such mission; the message lists those there are.
    """
    found = MISSIONS.find(name, f"{', '.join(MISSIONS)}; one of your own is given as module:NAME")
    if not isinstance(found, Mission):
        raise MissionError(f"{name!r} is a {type(found).__name__}, not a missions.engine.mission.Mission")
    return found


def find_robot(name: str) -> tuple[Model, Mission | None]:
    """Return the model of a robot, and its mission if it has one: of a mission, a file, or module:NAME of either.

    Raises:
        MissionError, KnowledgeBaseError: there is no such thing, or it cannot be read or made.
    """
    if Path(name).suffix in (".tql", ".owl"):
        return Model.load(name), None
    found = MISSIONS.find(name, f"{', '.join(MISSIONS)}; one of your own is a file (.tql, .owl) or module:NAME")
    if isinstance(found, Mission):
        return found.model(), found
    if not (isinstance(found, Model) or callable(found)):
        raise MissionError(f"{name!r} is no mission, no model and no function that makes one, but {found!r:.80}")
    return found if isinstance(found, Model) else built(name, Model, found), None


@contextmanager
def needs(extra: str, what: str) -> Iterator[None]:
    """Say which extra is missing when an import inside fails.

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
