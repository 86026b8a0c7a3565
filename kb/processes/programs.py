"""How a component is run as a process of the operating system."""

import json
import math
import os
import re
import shutil
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

from kb.elements import Parameters
from kb.exceptions import InvalidValue, KnowledgeBaseError

__all__ = ["PARAMETERS", "Program"]

PARAMETERS: Final = "KB_PARAMETERS"
"""The variable of the environment in which a process finds all its parameters, as a JSON object."""

_PLACE = re.compile(r"\{\{(\w+)\}\}|\{([^\W\d]\w*)\}")


@dataclass(frozen=True, slots=True)
class Program:
    """What is run for a component, with what, and what happens when it ends by itself.

    Attributes:
        arguments: the executable and its arguments; no shell reads them. `{name}` in an argument, or in a value of the
            environment, stands for the parameter of that name; `{{name}}` stands for `{name}`.
        environment: variables in addition to those of this process.
        directory: where it is run; None for where this process is.
        configure: called with the parameters, and with the number of the process or None if there is none, whenever
            parameters are set; a program without it gets new parameters only when it starts.
        grace: how long it may take to end when it is told to [s]; then it is killed.
        restarts: how often in a row it may be started again after it ended by itself, before it counts as failed.
        back_off: how long it is not started again then [s]; twice as long after each further time in a row.
        steady: how long it has to run [s] for its ends no longer to count as in a row.
    """

    arguments: Sequence[str]
    environment: Mapping[str, str] = field(default_factory=dict)
    directory: str | Path | None = None
    configure: Callable[[Parameters, int | None], None] | None = None
    grace: float = 5.0
    restarts: int = 0
    back_off: float = 0.5
    steady: float = 60.0

    def __post_init__(self) -> None:
        if isinstance(self.arguments, str) or not isinstance(self.arguments, Sequence) or not self.arguments:
            raise InvalidValue(
                f'arguments are a list that begins with the executable, e.g. ["node", "--quiet"], not '
                f"{self.arguments!r}; no shell takes them apart"
            )
        for argument in self.arguments:
            _check_text("an argument", argument)
        if not isinstance(self.environment, Mapping):
            raise InvalidValue(f"an environment is a mapping of text to text, not {self.environment!r}")
        for name, value in self.environment.items():
            _check_text("the name of a variable of the environment", name)
            _check_text(f"the variable {name} of the environment", value)
            if not name or "=" in name:
                raise InvalidValue(f"{name!r} cannot be the name of a variable: it is not empty and has no '='")
        if isinstance(self.restarts, bool) or not isinstance(self.restarts, int) or self.restarts < 0:
            raise InvalidValue(f"restarts are a whole number from 0, not {self.restarts!r}")
        for what in ("grace", "back_off", "steady"):
            value = getattr(self, what)
            if isinstance(value, bool) or not isinstance(value, int | float) or not 0 <= value < math.inf:
                raise InvalidValue(f"{what} is a finite number of seconds from 0, not {value!r}")

    def check(self) -> None:
        """Raise if it cannot be run because something is missing on this machine."""
        directory, name = Path(self.directory or "."), self.arguments[0]
        if not directory.is_dir():
            what = "is no directory" if directory.exists() else "does not exist"
            raise InvalidValue(f"the working directory {str(directory)!r} {what}; create it or name another")
        if os.sep not in name:
            path = self.environment.get("PATH", os.environ.get("PATH"))
            if shutil.which(name, path=path) is None:
                raise InvalidValue(
                    f"no executable {name!r} is found in the directories of PATH; install it, or give its whole path"
                )
            return
        file = directory / name
        if not file.is_file():
            what = "is no file" if file.exists() else "does not exist"
            raise InvalidValue(f"the executable {str(file)!r} {what}; correct the path")
        if not os.access(file, os.X_OK):
            raise InvalidValue(
                f"{str(file)!r} is not executable; allow it with chmod +x, or name its interpreter first"
            )

    def command(self, parameters: Parameters) -> list[str]:
        """Return the arguments with the parameters in place.

        Raises:
            KnowledgeBaseError: a parameter that has a place was not given.
        """
        return [_placed(argument, parameters) for argument in self.arguments]

    def variables(self, parameters: Parameters) -> dict[str, str]:
        """Return the variables in addition to those of this process, with the parameters in place."""
        own = {name: _placed(value, parameters) for name, value in self.environment.items()}
        return {PARAMETERS: json.dumps(dict(parameters)), **own}


def _check_text(what: str, value: object) -> None:
    if not isinstance(value, str):
        raise InvalidValue(f"{what} is text, not {value!r}; write it as {str(value)!r}")
    if "\0" in value:
        raise InvalidValue(f"{what} cannot hold a null character: {value!r}")


def _placed(text: str, parameters: Parameters) -> str:
    def put(place: re.Match[str]) -> str:
        literal, name = place.groups()
        if literal is not None:
            return f"{{{literal}}}"
        if name not in parameters:
            known = ", ".join(map(repr, parameters)) or "none"
            raise KnowledgeBaseError(f"{text!r} needs the parameter {name!r}; given are: {known}")
        value = parameters[name]
        return value if isinstance(value, str) else json.dumps(value)

    return _PLACE.sub(put, text)
