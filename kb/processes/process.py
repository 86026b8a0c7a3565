"""One component as a process: what is run for it, and the process as which it runs, if it does."""

import json
import logging
import math
import os
import re
import shutil
import signal
import subprocess
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final

from kb.elements import Parameters
from kb.exceptions import InvalidValue, KnowledgeBaseError
from kb.processes.guardian import MARK, has_others, started

__all__ = ["PARAMETERS", "ProcessHandle", "Program", "Report"]

_log = logging.getLogger(__name__)

PARAMETERS: Final = "KB_PARAMETERS"
"""The variable of the environment in which a process finds all its parameters, as a JSON object."""

Report = tuple[str, tuple[Any, ...]]
"""What the knowledge base is to be told: name of its method, and the arguments, of which the component is the first."""

_PLACE = re.compile(r"\{\{(\w+)\}\}|\{([^\W\d]\w*)\}")
_MOST_DOUBLINGS: Final = 60


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
        file = directory / name
        is_path = os.sep in name
        if not directory.is_dir():
            what = "is no directory" if directory.exists() else "does not exist"
            problem = f"the working directory {str(directory)!r} {what}; create it or name another"
        elif not is_path and shutil.which(name, path=self.environment.get("PATH", os.environ.get("PATH"))) is None:
            problem = f"no executable {name!r} is found in the directories of PATH; install it, or give its whole path"
        elif is_path and not file.is_file():
            what = "is no file" if file.exists() else "does not exist"
            problem = f"the executable {str(file)!r} {what}; correct the path"
        elif is_path and not os.access(file, os.X_OK):
            problem = f"{str(file)!r} is not executable; allow it with chmod +x, or name its interpreter first"
        else:
            return
        raise InvalidValue(problem)

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


class ProcessHandle:
    """A component on its way to running, or to an end; each call does what can be done without waiting.

    Args:
        name: of the component.
        program: what is run.
        clock: gives the time [s].
        reports: where everything that happens is entered.

    Attributes:
        process: as which it runs; None if it does not.
        crash: number of the process that ended by itself last, and how, in words.
    """

    def __init__(self, name: str, program: Program, clock: Callable[[], float], reports: deque[Report]) -> None:
        self._name = name
        self._program = program
        self._clock = clock
        self._reports = reports
        self.process: subprocess.Popen[bytes] | None = None
        self.crash = (-1, "")
        self._parameters: Parameters = MappingProxyType({})
        self._in_force: Parameters = self._parameters
        self._started = 0.0
        self._kill_at: float | None = None
        self._crashes = 0
        self._not_before = 0.0
        self._predecessors: dict[int, int | None] = {}

    def wait_for(self, predecessor: int) -> None:
        """Do not start before a process that is not a child of this one is gone."""
        self._predecessors[predecessor] = started(predecessor)

    def set_parameters(self, parameters: Parameters) -> None:
        """Take parameters, for the next start if there is no way to give them to what runs."""
        self.look()
        pid = None if self.process is None else self.process.pid
        if self._program.configure is not None:
            self._program.configure(parameters, pid)
        elif pid is not None and parameters != self._in_force:
            raise KnowledgeBaseError(
                f"{self._name!r} takes no parameters while it runs; declare the component with "
                f"stops_to_configure=True, or give its Program a function configure"
            )
        else:
            self._program.command(parameters)
        self._parameters = parameters

    def start(self, mark: str) -> int | None:
        """Go on towards running; returns the process number once it does."""
        self.look()
        if self.process is None and self._clock() >= self._not_before and self._is_free():
            self._spawn(mark)
        return None if self.process is None or self._kill_at is not None else self.process.pid

    def stop(self, *, kill: bool = False) -> bool:
        """Go on towards an end; returns whether nothing is left."""
        self.look()
        if self.process is None:
            self._crashes, self._not_before = 0, 0.0
            return True
        if self._kill_at is None:
            self._kill_at = self._clock() + self._program.grace
            _signal_group(self.process.pid, signal.SIGTERM)
        if kill:
            _signal_group(self.process.pid, signal.SIGKILL)
        self.look()
        return self.process is None

    def look(self) -> None:
        """Take note of an end."""
        process = self.process
        if process is None:
            return
        is_over = _has_ended(process.pid)
        if self._kill_at is None:
            if is_over:
                self._note_crash(process)
        elif is_over and not has_others(process.pid):
            self._bury(process)
        elif self._clock() >= self._kill_at:
            _signal_group(process.pid, signal.SIGKILL)

    def _is_free(self) -> bool:
        """Tell whether everything that has to be gone is."""
        waited_for = self._predecessors.items()
        self._predecessors = {pid: began for pid, began in waited_for if began is not None and started(pid) == began}
        return not self._predecessors

    def _spawn(self, mark: str) -> None:
        program = self._program
        program.check()
        command, variables = program.command(self._parameters), program.variables(self._parameters)
        try:
            self.process = subprocess.Popen(
                command,
                cwd=program.directory,
                env={**os.environ, **variables, MARK: mark},
                stdin=subprocess.DEVNULL,
                start_new_session=True,
            )
        except OSError as error:
            raise KnowledgeBaseError(
                f"{command[0]!r} cannot be run: {error.strerror}; see whether its first line names an interpreter "
                "that is there"
            ) from None
        self._started, self._in_force, self.crash = self._clock(), self._parameters, (-1, "")
        self._report("component_started", self.process.pid)

    def _note_crash(self, process: subprocess.Popen[bytes]) -> None:
        _signal_group(process.pid, signal.SIGKILL)  # what it leaves behind
        self._bury(process)
        now, reason = self._clock(), f"the process of {self._name} ended by itself ({_manner(process.returncode)})"
        self.crash = (process.pid, reason)
        _log.warning("%s", reason)
        self._report("component_active", False, reason)
        if now - self._started >= self._program.steady:
            self._crashes = 0
        self._crashes += 1
        if self._crashes > self._program.restarts:
            self._crashes, self._not_before = 0, 0.0
            self._report("component_failed", reason)
        else:
            self._not_before = now + self._program.back_off * 2.0 ** min(self._crashes - 1, _MOST_DOUBLINGS)

    def _bury(self, process: subprocess.Popen[bytes]) -> None:
        process.wait()
        self.process, self._kill_at = None, None
        self._report("component_ended", process.pid)

    def _report(self, verb: str, *arguments: object) -> None:
        self._reports.append((verb, (self._name, *arguments)))


def _has_ended(pid: int) -> bool:
    """Tell whether a child has ended, and leave it unburied, so that its number stays its own."""
    try:
        return os.waitid(os.P_PID, pid, os.WEXITED | os.WNOHANG | os.WNOWAIT) is not None
    except ChildProcessError:
        return True


def _signal_group(leader: int, number: signal.Signals) -> None:
    """Send a signal to a process group, if it is still there."""
    try:
        os.killpg(leader, number)
    except ProcessLookupError:
        return
    except PermissionError as error:
        _log.warning("process group %d could not be sent %s: %s", leader, number.name, error)


def _manner(code: int) -> str:
    """Say how a process ended, by what `subprocess` gives as its return code."""
    if code >= 0:
        return f"exit status {code}"
    try:
        return signal.Signals(-code).name
    except ValueError:
        return f"signal {-code}"
