"""Components that are processes of the operating system."""

import atexit
import logging
import os
import subprocess
import sys
import time
from collections import deque
from collections.abc import Callable, Mapping
from pathlib import Path
from threading import RLock
from types import MappingProxyType, TracebackType
from typing import Final, TypeVar

from kb.elements import Parameters
from kb.exceptions import InvalidValue, KnowledgeBaseError, UnknownName
from kb.knowledge_base import KnowledgeBase
from kb.processes import guardian
from kb.processes.proc import MARK, left_over, new_mark
from kb.processes.programs import Program
from kb.processes.run import News, Run

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
        self._mark = new_mark()
        self._grace = max((program.grace for program in programs.values()), default=0.0)
        self._news: deque[News] = deque()
        self._runs = {name: Run(name, program, clock, self._news) for name, program in programs.items()}
        self._lock = RLock()
        self._guardian: subprocess.Popen[bytes] | None = None
        self._tidiers: dict[str, subprocess.Popen[bytes]] = {}
        self._told: KnowledgeBase | None = None
        self._owner = os.getpid()
        self._is_open = True
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
        """Tell the knowledge base what started and ended since the last time.

        One that is seen for the first time may have another past, e.g. of a program that was killed. It is told which
        of its processes are no more, and what of them is there all the same is ended.

        Raises:
            UnknownName: a program was given for a component that the model does not have; at the first time only.
        """
        if kb is not self._told:
            self._told = kb
            for name in self._runs:
                kb.components.node(name)
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
            left = list(self._runs.values())
            while left and time.monotonic() < started + self._grace + _TO_DIE_S:
                is_over = time.monotonic() >= started + self._grace
                left = [run for run in left if not run.stop(kill=is_over)]
                if left:
                    time.sleep(_PERIOD_OF_CLOSING_S)
            for one in (self._guardian, *self._tidiers.values()):
                if one is not None:
                    _dismiss(one, self._grace)
        if self._told is not None:
            self._tell_the_end(self._told)

    def __enter__(self) -> "ProcessComponents":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _run(self, component: str) -> Run:
        if component not in self._runs:
            raise UnknownName("process component", component, self._runs)
        return self._runs[component]

    def _meet(self, kb: KnowledgeBase) -> None:
        """Tell a knowledge base what is true of what it believes to run."""
        with self._lock:
            for run in self._runs.values():
                run.look()
            mine = {name: run.process.pid for name, run in self._runs.items() if run.process is not None}
        for one in kb.processes:
            if one.component in self._runs and one.end is None and mine.get(one.component) != one.pid:
                self._tidy_up(one.component, one.pid)
                kb.component_ended(one.component, one.pid)
        for name in self._runs:
            kb.component_active(name, name in mine, "" if name in mine else f"the process of {name} is no more")

    def _tidy_up(self, component: str, pid: int) -> None:
        """Have what was started in another life ended, if it lives on, and nothing started in its place before that."""
        mark = left_over(pid)
        if mark is None:
            return
        with self._lock:
            self._runs[component].wait_for(pid)
            if self._is_open and mark not in self._tidiers:
                _log.warning("the process of %s, %d, was left over and is ended", component, pid)
                self._tidiers[mark] = _guard(mark, self._grace, _NOBODY)

    def _tell(self, kb: KnowledgeBase) -> None:
        with self._lock:
            for run in self._runs.values():
                run.look()
            news = tuple(self._news)
            self._news.clear()
        for one in news:
            if one.component in kb.components:
                _told(kb, one)

    def _tell_the_end(self, kb: KnowledgeBase) -> None:
        """Tell what has become of everything; an end is never an error, also if it cannot be told any more."""
        try:
            self._tell(kb)
            for name in self._runs:
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


def _guard(mark: str, grace: float, parent: int) -> subprocess.Popen[bytes]:
    """Start a guardian; see its module."""
    return subprocess.Popen(
        [sys.executable, "-I", "-S", guardian.__file__, f"{MARK}={mark}", str(grace), str(parent)],
        stdin=subprocess.PIPE,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        env={name: value for name, value in os.environ.items() if name != MARK},
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


class _Start:
    """A component on its way to running; failed if its process ends by itself while somebody still asks."""

    def __init__(self, run: Run, mark: str, lock: RLock) -> None:
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

    def __init__(self, run: Run, lock: RLock) -> None:
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


def _told(kb: KnowledgeBase, news: News) -> None:
    if news.what == "started":
        kb.component_started(news.component, news.pid)
    elif news.what == "failed":
        kb.component_failed(news.component, news.reason)
    else:
        kb.component_ended(news.component, news.pid)
        if news.what == "crashed":
            kb.component_active(news.component, False, news.reason)
