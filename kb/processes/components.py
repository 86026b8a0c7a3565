"""Components that are processes of the operating system."""

import atexit
import logging
import os
import secrets
import signal
import subprocess
import sys
import time
from collections import deque
from collections.abc import Callable, Mapping
from pathlib import Path
from threading import RLock
from types import MappingProxyType, TracebackType
from typing import Final, NamedTuple, TypeVar

from kb.elements import Parameters
from kb.exceptions import InvalidValue, KnowledgeBaseError, UnknownName
from kb.knowledge_base import KnowledgeBase
from kb.processes import guardian
from kb.processes.programs import Program

__all__ = ["ProcessComponents"]

_log = logging.getLogger(__name__)

_MARK: Final = "KB_STARTED_BY"
_TO_DIE_S: Final = 5.0
"""How long what was killed may take to be gone, before one does without."""
_PERIOD_OF_CLOSING_S: Final = 0.01
_MOST_DOUBLINGS: Final = 60


class _News(NamedTuple):
    """Something that the knowledge base is to be told: a process "started", "ended" or "crashed", or "failed"."""

    component: str
    what: str
    pid: int


class ProcessComponents:
    """A managed system, and the monitor, of components that are processes.

    Each runs in a process group of its own, without a shell. It is told to end with SIGTERM; after its grace the whole
    group is killed. Have the manager ask it at each turn (`monitors=[processes]`): so the knowledge base gets to know
    what was started, has ended, or ended by itself. Close it, or use it in a `with` statement; nothing is left behind
    either way, even if this process is killed.

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
        self._mark = secrets.token_hex(16)  # an identity; nothing is decided by it
        self._grace = max((program.grace for program in programs.values()), default=0.0)
        self._news: deque[_News] = deque()
        self._runs = {name: _Run(name, program, clock, self._news) for name, program in programs.items()}
        self._lock = RLock()
        self._guardian: subprocess.Popen[bytes] | None = None
        self._owner = os.getpid()
        self._is_open = True
        self._is_checked = False
        atexit.register(self.close)

    def activate(self, component: str) -> "_Start":
        """Start a component; one that is still ending, or ended by itself a moment ago, once somebody asks later."""
        run = self._run(component)
        with self._lock:
            if not self._is_open:
                raise KnowledgeBaseError(f"{component!r} cannot be started: its processes are closed for good")
            self._have_guardian()
            return _begun(_Start(run, self._mark, self._lock))

    def deactivate(self, component: str) -> "_Stop":
        """End a component: tell it to, and kill its process group after its grace."""
        return _begun(_Stop(self._run(component), self._lock))

    def set_parameters(self, component: str, parameters: Parameters) -> None:
        """Give a component its parameters, for its next start if it has no way to take them while it runs."""
        run = self._run(component)
        with self._lock:
            run.set_parameters(MappingProxyType(dict(parameters)))

    def is_active(self, component: str) -> bool:
        """Tell whether the process of a component is there."""
        run = self._run(component)
        with self._lock:
            run.look()
            return run.process is not None

    def observe(self, kb: KnowledgeBase) -> None:
        """Tell the knowledge base what started and ended since the last time."""
        with self._lock:
            for run in self._runs.values():
                run.look()
            news = tuple(self._news)
            self._news.clear()
        if not self._is_checked:
            self._is_checked = True
            for name in self._runs:
                kb.components.node(name)
        for one in news:
            if one.component in kb.components:
                _tell(kb, one)

    def close(self) -> None:
        """End everything and wait for that, as long as the longest grace at most; nothing can be started any more."""
        with self._lock:
            if not self._is_open or os.getpid() != self._owner:  # a fork of this process owns none of the processes
                return
            self._is_open = False
            atexit.unregister(self.close)
            started = time.monotonic()
            left = list(self._runs.values())
            while left and time.monotonic() < started + self._grace + _TO_DIE_S:
                is_over = time.monotonic() >= started + self._grace
                left = [run for run in left if not run.stop(kill=is_over)]
                if left:
                    time.sleep(_PERIOD_OF_CLOSING_S)
            self._dismiss_guardian()

    def __enter__(self) -> "ProcessComponents":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _run(self, component: str) -> "_Run":
        if component not in self._runs:
            raise UnknownName("process component", component, self._runs)
        return self._runs[component]

    def _have_guardian(self) -> None:
        """See that somebody ends the processes if this one is killed."""
        if self._guardian is not None:
            if self._guardian.poll() is None:
                return
            self._dismiss_guardian()
        environment = {name: value for name, value in os.environ.items() if name != _MARK}
        told = [f"{_MARK}={self._mark}", str(self._grace), str(os.getpid())]
        self._guardian = subprocess.Popen(
            [sys.executable, "-I", "-S", guardian.__file__, *told],
            stdin=subprocess.PIPE,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            env=environment,
            start_new_session=True,
        )

    def _dismiss_guardian(self) -> None:
        """Have the guardian end what has left its process group, and end itself."""
        if self._guardian is None:
            return
        assert self._guardian.stdin is not None
        self._guardian.stdin.close()
        try:
            self._guardian.wait(self._grace + _TO_DIE_S)
        except subprocess.TimeoutExpired:
            self._guardian.kill()
            self._guardian.wait()


class _Run:
    """One component: the process as which it runs, if it does, and how often it has ended by itself."""

    def __init__(self, name: str, program: Program, clock: Callable[[], float], news: deque[_News]) -> None:
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

    def set_parameters(self, parameters: Parameters) -> None:
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
        if self.process is None and self._clock() >= self._not_before:
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
        has_ended = _has_ended(process.pid)
        if self._kill_at is None:
            if has_ended:
                self._take_crash(process)
            return
        if not (has_ended and _is_alone(process.pid)):
            if self._clock() >= self._kill_at:
                _signal_group(process.pid, signal.SIGKILL)
            return
        self._bury(process)
        self._news.append(_News(self.name, "ended", process.pid))

    def _spawn(self, mark: str) -> None:
        program = self.program
        program.check()
        self.process = subprocess.Popen(
            program.command(self.parameters),
            cwd=program.directory,
            env={**os.environ, **program.variables(self.parameters), _MARK: mark},
            stdin=subprocess.DEVNULL,
            start_new_session=True,
        )
        self._started, self._in_force, self.crash = self._clock(), self.parameters, (-1, "")
        self._news.append(_News(self.name, "started", self.process.pid))

    def _take_crash(self, process: subprocess.Popen[bytes]) -> None:
        _signal_group(process.pid, signal.SIGKILL)  # what it leaves behind
        self._bury(process)
        now, text = self._clock(), f"{self.name!r} ended by itself {_manner(process.returncode)}"
        self.crash = (process.pid, text)
        _log.warning("%s", text)
        self._news.append(_News(self.name, "crashed", process.pid))
        if now - self._started >= self.program.steady:
            self._crashes = 0
        self._crashes += 1
        if self._crashes > self.program.restarts:
            self._crashes, self._not_before = 0, 0.0
            self._news.append(_News(self.name, "failed", process.pid))
        else:
            doublings = min(self._crashes - 1, _MOST_DOUBLINGS)
            self._not_before = now + self.program.back_off * 2.0**doublings

    def _bury(self, process: subprocess.Popen[bytes]) -> None:
        process.wait()
        self.process, self._kill_at = None, None


class _Start:
    """A component on its way to running; failed if its process ends by itself while somebody still asks."""

    def __init__(self, run: _Run, mark: str, lock: RLock) -> None:
        self._run = run
        self._mark = mark
        self._lock = lock
        self._pid: int | None = None

    def done(self) -> bool:
        with self._lock:
            if self._pid is None:
                self._pid = self._run.start(self._mark)
            return self._pid is not None

    def exception(self) -> KnowledgeBaseError | None:
        with self._lock:
            self._run.look()
            pid, text = self._run.crash
            return KnowledgeBaseError(text) if pid == self._pid else None


class _Stop:
    """A component on its way to an end."""

    def __init__(self, run: _Run, lock: RLock) -> None:
        self._run = run
        self._lock = lock

    def done(self) -> bool:
        with self._lock:
            return self._run.stop()

    def exception(self) -> None:
        return None


_Begun = TypeVar("_Begun", _Start, _Stop)


def _begun(operation: _Begun) -> _Begun:
    operation.done()
    return operation


def _tell(kb: KnowledgeBase, news: _News) -> None:
    if news.what == "started":
        kb.component_started(news.component, news.pid)
    elif news.what == "failed":
        kb.component_failed(news.component)
    else:
        kb.component_ended(news.component, news.pid)
        if news.what == "crashed":
            kb.component_active(news.component, False)


def _has_ended(pid: int) -> bool:
    """Tell whether a child has ended, and leave it unburied, so that its number stays its own."""
    try:
        return os.waitid(os.P_PID, pid, os.WEXITED | os.WNOHANG | os.WNOWAIT) is not None
    except ChildProcessError:
        return True


def _is_alone(leader: int) -> bool:
    """Tell whether nothing else lives in the process group of a process."""
    for folder in Path("/proc").iterdir():
        if folder.name.isdigit() and folder.name != str(leader):
            try:
                state, _, group = (folder / "stat").read_bytes().rpartition(b")")[2].split()[:3]
            except (OSError, ValueError):
                continue
            if int(group) == leader and state not in (b"Z", b"X"):
                return False
    return True


def _signal_group(leader: int, number: signal.Signals) -> None:
    try:
        os.killpg(leader, number)
    except ProcessLookupError:
        return
    except PermissionError as error:
        _log.warning("process group %d could not be sent %s: %s", leader, number.name, error)


def _manner(code: int) -> str:
    if code >= 0:
        return f"with status {code}"
    try:
        return f"of {signal.Signals(-code).name}"
    except ValueError:
        return f"of signal {-code}"
