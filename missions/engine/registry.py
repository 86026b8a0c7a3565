"""Import missions and the like by name, and optional libraries, only when they are asked for."""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from importlib import import_module
from pathlib import Path
from traceback import extract_tb
from typing import Any, Final

from kb import Model
from missions import SUMMARIES
from missions.engine.mission import Mission, MissionError, built
from missions.engine.settings import near

MISSIONS: Final = {name: f"missions.{name}:MISSION" for name in SUMMARIES}
"""The registered missions, by name: where each is defined."""


def load(kind: str, name: str, homes: Mapping[str, str], known: str) -> Any:  # noqa: ANN401  # whoever asks checks it
    """Import a thing of some kind, such as "mission", by a registered name or as "module:NAME".

    `homes` has the "module:NAME" of each registered name; `known` lists what exists, for the error message.

    Raises:
        MissionError: the name is unknown, or the import fails.
    """
    if name not in homes and ":" not in name[1:]:
        raise MissionError(f"unknown {kind} {name!r}; there are {known}")
    module, _, attribute = homes.get(name, name).partition(":")
    try:
        found = import_module(module)
        if not hasattr(found, attribute):
            close = near(attribute, vars(found)) or [one for one in vars(found) if one.isupper()]
            did = f"; did you mean {' or '.join(f'{module}:{one}' for one in close)}?" if close else ""
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
    found = load("mission", name, MISSIONS, f"{', '.join(MISSIONS)}; one of your own is given as module:NAME")
    if not isinstance(found, Mission):
        raise MissionError(f"{name!r} is a {type(found).__name__}, not a missions.engine.mission.Mission")
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
        raise MissionError(f"{name!r} is no mission, no model and no function that makes one, but {found!r:.80}")
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
