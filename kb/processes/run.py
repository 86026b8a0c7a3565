"""One component: the process as which it runs, if it does, and how often that has ended by itself."""

import logging
import os
import signal
import subprocess
from collections import deque
from collections.abc import Callable
from types import MappingProxyType
from typing import Final, NamedTuple

from kb.elements import Parameters
from kb.exceptions import KnowledgeBaseError
from kb.processes.proc import MARK, has_ended, is_alone, manner, signal_group, started
from kb.processes.programs import Program

__all__ = ["News", "Run"]

_log = logging.getLogger(__name__)

_MOST_DOUBLINGS: Final = 60


class News(NamedTuple):
    """Something that the knowledge base is to be told.

    Attributes:
        component: its name.
        what: its process "started", "ended" as it was told to, or "crashed"; or the component "failed".
        pid: number of the process.
        reason: why, in words.
    """

    component: str
    what: str
    pid: int
    reason: str = ""


class Run:
    """A component on its way to running, or to an end; each call does what can be done without waiting.

    Args:
        name: of the component.
        program: what is run.
        clock: gives the time [s].
        news: where everything that happens is entered.

    Attributes:
        process: as which it runs; None if it does not.
        crash: number of the process that ended by itself last, and how, in words.
    """

    def __init__(self, name: str, program: Program, clock: Callable[[], float], news: deque[News]) -> None:
        self.name = name
        self.program = program
        self.parameters: Parameters = MappingProxyType({})
        self.process: subprocess.Popen[bytes] | None = None
        self.crash = (-1, "")
        self._clock = clock
        self._news = news
        self._started = 0.0
        self._kill_at: float | None = None
        self._crashes = 0
        self._not_before = 0.0
        self._in_force: Parameters = self.parameters
        self._predecessors: dict[int, int | None] = {}

    def wait_for(self, predecessor: int) -> None:
        """Do not start before a process that is not a child of this one is gone."""
        self._predecessors[predecessor] = started(predecessor)

    def set_parameters(self, parameters: Parameters) -> None:
        """Take parameters, for the next start if there is no way to give them to what runs."""
        self.look()
        pid = None if self.process is None else self.process.pid
        if self.program.configure is not None:
            self.program.configure(parameters, pid)
        elif pid is not None and parameters != self._in_force:
            raise KnowledgeBaseError(
                f"{self.name!r} takes no parameters while it runs; declare the component with stops_to_configure=True, "
                f"or give its Program a function configure"
            )
        else:
            self.program.command(parameters)
        self.parameters = parameters

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
            self._kill_at = self._clock() + self.program.grace
            signal_group(self.process.pid, signal.SIGTERM)
        if kill:
            signal_group(self.process.pid, signal.SIGKILL)
        self.look()
        return self.process is None

    def look(self) -> None:
        """Take note of an end."""
        process = self.process
        if process is None:
            return
        is_over = has_ended(process.pid)
        if self._kill_at is None:
            if is_over:
                self._take_crash(process)
            return
        if not (is_over and is_alone(process.pid)):
            if self._clock() >= self._kill_at:
                signal_group(process.pid, signal.SIGKILL)
            return
        self._bury(process)
        self._news.append(News(self.name, "ended", process.pid))

    def _is_free(self) -> bool:
        """Tell whether everything that has to be gone is."""
        self._predecessors = {
            pid: began for pid, began in self._predecessors.items() if began is not None and started(pid) == began
        }
        return not self._predecessors

    def _spawn(self, mark: str) -> None:
        program = self.program
        program.check()
        command, variables = program.command(self.parameters), program.variables(self.parameters)
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
        self._started, self._in_force, self.crash = self._clock(), self.parameters, (-1, "")
        self._news.append(News(self.name, "started", self.process.pid))

    def _take_crash(self, process: subprocess.Popen[bytes]) -> None:
        signal_group(process.pid, signal.SIGKILL)  # what it leaves behind
        self._bury(process)
        now, reason = self._clock(), f"the process of {self.name} ended by itself ({manner(process.returncode)})"
        self.crash = (process.pid, reason)
        _log.warning("%s", reason)
        self._news.append(News(self.name, "crashed", process.pid, reason))
        if now - self._started >= self.program.steady:
            self._crashes = 0
        self._crashes += 1
        if self._crashes > self.program.restarts:
            self._crashes, self._not_before = 0, 0.0
            self._news.append(News(self.name, "failed", process.pid, reason))
        else:
            doublings = min(self._crashes - 1, _MOST_DOUBLINGS)
            self._not_before = now + self.program.back_off * 2.0**doublings

    def _bury(self, process: subprocess.Popen[bytes]) -> None:
        process.wait()
        self.process, self._kill_at = None, None
