"""Components that are processes of the operating system."""

import atexit
import logging
import os
import subprocess
import sys
import time
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from threading import RLock
from types import MappingProxyType, TracebackType
from typing import Final

from kb.elements import Parameters
from kb.exceptions import InvalidValue, KnowledgeBaseError, UnknownName
from kb.knowledge_base import KnowledgeBase
from kb.processes import guardian
from kb.processes.process import ProcessHandle, Program, Report

__all__ = ["ProcessComponents"]

_log = logging.getLogger(__name__)

_TO_DIE_S: Final = 5.0
"""How long what was killed may take to be gone, before one does without."""
_PERIOD_OF_CLOSING_S: Final = 0.01
_NOBODY: Final = 0
"""No process has this number, so a guardian that is given it as a parent begins to end things at once."""


class ProcessComponents:
    """A managed system, and the monitor, of components that are processes.

    Each runs in a process group of its own, without a shell. It is told to end with SIGTERM; after its grace the whole
    group is killed. Have the manager ask it at each turn (`monitors=[processes]`): so the knowledge base gets to know
    what was started, has ended, or ended by itself; and, at the first time, that nothing runs that was started before
    this was made. Close it, or use it in a `with` statement; nothing is left behind either way, even if this process is
    killed.

    Args:
        programs: what to run, by name of the component.
        clock: gives the time [s] of grace and restarts; processes take real time, so that is the default.

    Raises:
        InvalidValue: one of the programs cannot be run on this machine.
    """

    def __init__(self, programs: Mapping[str, Program], *, clock: Callable[[], float] = time.monotonic) -> None:
        if not Path("/proc/self/environ").exists():
            raise KnowledgeBaseError("components as processes need the /proc of Linux; manage them by objects instead")
        for name, program in programs.items():
            if not isinstance(program, Program):
                raise InvalidValue(f"component {name!r} is run as a kb.processes.Program, not as {program!r}")
            try:
                program.check()
            except InvalidValue as error:
                raise InvalidValue(f"component {name!r} cannot be run: {error}") from None
        self._mark = guardian.new_mark()
        self._grace = max((program.grace for program in programs.values()), default=0.0)
        self._reports: deque[Report] = deque()
        self._handles = {name: ProcessHandle(name, one, clock, self._reports) for name, one in programs.items()}
        self._lock = RLock()
        self._guardian: subprocess.Popen[bytes] | None = None
        self._tidiers: dict[str, subprocess.Popen[bytes]] = {}
        self._observed: KnowledgeBase | None = None
        self._owner = os.getpid()
        self._is_open = True
        atexit.register(self.close)

    def activate(self, component: str) -> "_Switch":
        """Start a component; one that is still ending, or ended by itself a moment ago, once somebody asks later."""
        handle = self._handle(component)
        with self._lock:
            if not self._is_open:
                raise KnowledgeBaseError(f"{component!r} cannot be started: its processes are closed for good")
            self._have_guardian()
            return _begun(_Switch(handle, self._lock, self._mark))

    def deactivate(self, component: str) -> "_Switch":
        """End a component: tell it to, and kill its process group after its grace."""
        return _begun(_Switch(self._handle(component), self._lock))

    def set_parameters(self, component: str, parameters: Parameters) -> None:
        """Give a component its parameters, for its next start if it has no way to take them while it runs."""
        handle = self._handle(component)
        with self._lock:
            handle.set_parameters(MappingProxyType(dict(parameters)))

    def is_active(self, component: str) -> bool:
        """Tell whether the process of a component is there."""
        handle = self._handle(component)
        with self._lock:
            handle.look()
            return handle.process is not None

    def observe(self, kb: KnowledgeBase) -> None:
        """Tell the knowledge base what started and ended since the last time.

        One that is seen for the first time may have another past, e.g. of a program that was killed. It is told which
        of its processes are no more, and what of them is there all the same is ended.

        Raises:
            UnknownName: a program was given for a component that the model does not have; at the first time only.
        """
        if kb is not self._observed:
            self._observed = kb
            for name in self._handles:
                kb.components[name]
            self._meet(kb)
        self._tell(kb)

    def close(self) -> None:
        """End everything and wait for that, as long as the longest grace at most; nothing can be started any more.

        The knowledge base that was observed last is told.
        """
        with self._lock:
            if not self._is_open or os.getpid() != self._owner:  # a fork of this process owns none of the processes
                return
            self._is_open = False
            atexit.unregister(self.close)
            started = time.monotonic()
            left = list(self._handles.values())
            while left and time.monotonic() < started + self._grace + _TO_DIE_S:
                is_over = time.monotonic() >= started + self._grace
                left = [handle for handle in left if not handle.stop(kill=is_over)]
                if left:
                    time.sleep(_PERIOD_OF_CLOSING_S)
            for one in (self._guardian, *self._tidiers.values()):
                if one is not None:
                    _dismiss(one, self._grace)
        if self._observed is not None:
            self._tell_the_end(self._observed)

    def __enter__(self) -> "ProcessComponents":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _handle(self, component: str) -> ProcessHandle:
        if component not in self._handles:
            raise UnknownName("process component", component, self._handles)
        return self._handles[component]

    def _meet(self, kb: KnowledgeBase) -> None:
        """Tell a knowledge base what is true of what it believes to run."""
        with self._lock:
            for handle in self._handles.values():
                handle.look()
            mine = {name: one.process.pid for name, one in self._handles.items() if one.process is not None}
        for process in kb.processes:
            name, pid = process.component, process.pid
            if name in self._handles and process.end is None and mine.get(name) != pid:
                self._tidy_up(name, pid)
                kb.component_ended(name, pid)
        for name in self._handles:
            kb.component_active(name, name in mine, "" if name in mine else f"the process of {name} is no more")

    def _tidy_up(self, component: str, pid: int) -> None:
        """Have what was started in another life ended, if it lives on, and nothing started in its place before that."""
        mark = guardian.left_over(pid)
        if mark is None:
            return
        with self._lock:
            self._handles[component].wait_for(pid)
            if self._is_open and mark not in self._tidiers:
                _log.warning("the process of %s, %d, was left over and is ended", component, pid)
                self._tidiers[mark] = _guard(mark, self._grace, _NOBODY)

    def _tell(self, kb: KnowledgeBase) -> None:
        with self._lock:
            for handle in self._handles.values():
                handle.look()
            reports = tuple(self._reports)
            self._reports.clear()
        for verb, arguments in reports:
            if arguments[0] in kb.components:
                getattr(kb, verb)(*arguments)

    def _tell_the_end(self, kb: KnowledgeBase) -> None:
        """Tell what has become of everything; an end is never an error, also if it cannot be told any more."""
        try:
            self._tell(kb)
            for name in self._handles:
                if name in kb.components:
                    kb.component_active(name, False, f"the process of {name} was ended with all others")
        except KnowledgeBaseError as error:
            _log.warning("the knowledge base was not told that the processes have ended: %s", error)

    def _have_guardian(self) -> None:
        """See that somebody ends the processes if this one is killed."""
        if self._guardian is not None:
            if self._guardian.poll() is None:
                return
            _dismiss(self._guardian, self._grace)
        self._guardian = _guard(self._mark, self._grace, os.getpid())


@dataclass(slots=True)
class _Switch:
    """A component on its way to running, or without a mark to an end.

    A start has failed if the process ends by itself while somebody still asks.
    """

    handle: ProcessHandle
    lock: RLock
    mark: str | None = None
    pid: int | None = None

    def done(self) -> bool:
        with self.lock:
            if self.mark is None:
                return self.handle.stop()
            self.pid = self.pid or self.handle.start(self.mark)
            return self.pid is not None

    def exception(self) -> KnowledgeBaseError | None:
        with self.lock:
            self.handle.look()
            pid, text = self.handle.crash
            return KnowledgeBaseError(text) if pid == self.pid else None


def _begun(operation: _Switch) -> _Switch:
    operation.done()
    return operation


def _guard(mark: str, grace: float, parent: int) -> subprocess.Popen[bytes]:
    """Start a guardian; see its module."""
    return subprocess.Popen(
        [sys.executable, "-I", "-S", guardian.__file__, f"{guardian.MARK}={mark}", str(grace), str(parent)],
        stdin=subprocess.PIPE,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        env={name: value for name, value in os.environ.items() if name != guardian.MARK},
        start_new_session=True,
    )


def _dismiss(one: subprocess.Popen[bytes], grace: float) -> None:
    """Have a guardian end what has left its process group, and end itself."""
    assert one.stdin is not None
    one.stdin.close()
    try:
        one.wait(grace + _TO_DIE_S)
    except subprocess.TimeoutExpired:
        one.kill()
        one.wait()
