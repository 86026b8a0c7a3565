"""Components that run as processes of the operating system: a managed system that starts, watches and ends them."""

import atexit
import json
import logging
import math
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager, suppress
from dataclasses import dataclass, field
from io import FileIO
from pathlib import Path
from select import POLLIN, poll
from tempfile import mkdtemp
from threading import Lock, RLock, Thread
from types import MappingProxyType
from typing import IO, Any, Final
from urllib.parse import quote

from kb.elements import Parameters, is_number, whole
from kb.exceptions import InvalidValue, KnowledgeBaseError, UnknownName
from kb.knowledge_base import KnowledgeBase
from kb.processes import guardian

_log = logging.getLogger(__name__)

PARAMETERS: Final = "KB_PARAMETERS"
"""The variable of the environment in which a process finds all its parameters, as a JSON object."""

MOST: Final = 1 << 20
"""How much output of each component is kept [bytes], in two files: the newest, and what came before it."""
_CHUNK, _TAIL, _LINES, _WIDTH = 1 << 16, 2000, 3, 160

_Report = tuple[
    str, tuple[Any, ...]
]  # a method of the knowledge base, and its arguments: the component first
_PLACE = re.compile(r"\{\{(\w+)\}\}|\{([^\W\d]\w*)\}")
_TO_DIE_S: Final = 5.0
"""How long a killed process may take to be gone [s]; after that nobody waits for it."""
_STEADY_S: Final = 60.0
"""How long a process must run [s] until its earlier ends no longer count as in a row."""


@dataclass(frozen=True, slots=True)
class Program:
    """The program of a component, its arguments and environment, and what happens when it ends by itself.

    Attributes:
        arguments: the executable and its arguments; no shell reads them. `{name}` in an argument, or in a value of the
            environment, stands for the parameter of that name; `{{name}}` stands for `{name}`.
        environment: variables in addition to those of this process.
        directory: where it is run; None for where this process is.
        configure: called with the parameters and the pid of the process (None if there is none) whenever parameters
            are set; a program without it gets new parameters only when it starts.
        grace: how long it may take to end after SIGTERM [s]; then it is killed.
        restarts: how often in a row it may be started again after it ended by itself before it counts as failed; a run
            of a minute begins a new row.
        back_off: the pause before it is started again [s]; it doubles after each further end in a row.
    """

    arguments: Sequence[str]
    environment: Mapping[str, str] = field(default_factory=dict)
    directory: str | Path | None = None
    configure: Callable[[Parameters, int | None], None] | None = None
    grace: float = 5.0
    restarts: int = 0
    back_off: float = 0.5

    def __post_init__(self) -> None:
        if (
            isinstance(self.arguments, str)
            or not isinstance(self.arguments, Sequence)
            or not self.arguments
        ):
            example = (
                'arguments are a list that begins with the executable, e.g. ["node", "--quiet"]'
            )
            raise InvalidValue(f"{example}, not {self.arguments!r}; no shell takes them apart")
        if not isinstance(self.environment, Mapping) or any(
            not one or "=" in str(one) for one in self.environment
        ):
            names = "whose names are not empty and have no '='"
            raise InvalidValue(
                f"an environment is a mapping of text to text, {names}, not {self.environment!r}"
            )
        for text in (*self.arguments, *self.environment, *self.environment.values()):
            if not isinstance(text, str) or "\0" in text:
                raise InvalidValue(
                    f"arguments and variables are text without null characters, not {text!r}"
                )
        whole("the number of restarts", self.restarts, 0)
        for what in ("grace", "back_off"):
            value = getattr(self, what)
            if not is_number(value) or not 0 <= value < math.inf:
                raise InvalidValue(f"{what} is a finite number of seconds from 0, not {value!r}")

    def check(self) -> None:
        """Raise `InvalidValue` if the executable or the directory is missing on this machine."""
        directory, name = Path(self.directory or "."), self.arguments[0]
        if not directory.is_dir():
            raise InvalidValue(
                f"there is no working directory {str(directory)!r}; create it or name another"
            )
        path = self.environment.get("PATH", os.environ.get("PATH"))
        if shutil.which(directory.absolute() / name if os.sep in name else name, path=path) is None:
            raise InvalidValue(
                f"no executable {name!r} is found; install it, correct the path, or chmod +x it"
            )

    def command(self, parameters: Parameters) -> list[str]:
        """Return the arguments with the parameters in place; one that was not given raises `KnowledgeBaseError`."""
        return [_placed(argument, parameters) for argument in self.arguments]

    def variables(self, parameters: Parameters) -> dict[str, str]:
        """Return the variables in addition to those of this process, with the parameters in place."""
        own = {name: _placed(value, parameters) for name, value in self.environment.items()}
        return {PARAMETERS: json.dumps(dict(parameters)), **own}


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


class ProcessComponents(AbstractContextManager["ProcessComponents"]):
    """A managed system, and a monitor, of components that are processes.

    Each process runs in a process group of its own, without a shell. It is asked to end with SIGTERM; after its grace
    the whole group is killed. Give this to the manager as a monitor too (`monitors=[processes]`): so the knowledge base
    is told what was started, what has ended, and what ended by itself; and, the first time, that nothing runs that was
    started before. Close it, or use it in a `with` statement; no process is left behind either way, even if this
    process is killed.

    The standard output and error of a component go to a file of its own, of which the newest MB is kept. When the
    component ends by itself, its last lines are part of the reason.

    Args:
        programs: what to run, by name of the component.
        output: the folder of these files, which stay there; None for a private one that goes when this is closed.

    Raises:
        InvalidValue: one of the programs cannot be run on this machine.
    """

    def __init__(
        self, programs: Mapping[str, Program], *, output: str | Path | None = None
    ) -> None:
        if not Path("/proc/self/environ").exists():
            raise KnowledgeBaseError(
                "components as processes need the /proc of Linux; manage them by objects instead"
            )
        for name, program in programs.items():
            if not isinstance(program, Program):
                raise InvalidValue(
                    f"component {name!r} is run as a kb.processes.Program, not as {program!r}"
                )
            try:
                program.check()
            except InvalidValue as error:
                raise InvalidValue(f"component {name!r} cannot be run: {error}") from None
        self._mark = guardian.new_mark()
        self._grace = max((program.grace for program in programs.values()), default=0.0)
        self._reports: deque[_Report] = deque()
        self._private = mkdtemp(prefix="kb-output-") if output is None else None
        folder = Path(self._private or output or ".")
        try:
            folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        except OSError as error:
            raise InvalidValue(
                f"output cannot go to {str(folder)!r}: {error.strerror}; name another folder"
            ) from None
        outputs = {name: Output(folder / f"{quote(name, safe=' ')[:200]}.log") for name in programs}
        self._handles = {
            name: _Handle(name, one, self._reports, outputs[name]) for name, one in programs.items()
        }
        self._lock = RLock()
        self._guardian: subprocess.Popen[bytes] | None = None
        self._tidiers: dict[str, subprocess.Popen[bytes]] = {}
        self._observed: KnowledgeBase | None = None
        self._owner = os.getpid()
        self._is_open = True
        atexit.register(self.close)

    def activate(self, component: str) -> "_Switch":
        """Start a component; one that is still ending, or in its back-off, starts at a later call of `done()`."""
        handle = self._handle(component)
        with self._lock:
            if not self._is_open:
                raise KnowledgeBaseError(
                    f"{component!r} cannot be started: its processes are closed for good"
                )
            if self._guardian is not None and self._guardian.poll() is not None:
                _dismiss(self._guardian, self._grace)
                self._guardian = None
            self._guardian = self._guardian or _guard(self._mark, self._grace, os.getpid())
            return _Switch(handle, self._lock, self._mark)

    def deactivate(self, component: str) -> "_Switch":
        """End a component with SIGTERM; its process group is killed after its grace."""
        return _Switch(self._handle(component), self._lock)

    def set_parameters(self, component: str, parameters: Parameters) -> None:
        """Set the parameters of a component; without `configure` they count from its next start on."""
        handle = self._handle(component)
        with self._lock:
            handle.set_parameters(MappingProxyType(dict(parameters)))

    def is_active(self, component: str) -> bool:
        """Return whether a component runs; one that ended by itself counts as running until `observe` tells why."""
        handle = self._handle(component)
        with self._lock:
            handle.look()
            news = (
                []
                if self._observed is None
                else [(verb, arguments[0]) for verb, arguments in self._reports]
            )
            return handle.process is not None or ("component_active", component) in news

    def output(self, component: str) -> Path:
        """Return the file of a component's newest output; older output is in FILE.1 beside it."""
        return self._handle(component).output.path

    def observe(self, kb: KnowledgeBase) -> None:
        """Tell the knowledge base what started and ended since the last time.

        A knowledge base that is seen for the first time may have processes on record from an earlier program, e.g. one
        that was killed. They are recorded as ended, and those that still run are ended.

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
        """End all processes and wait, at most 5 s longer than the longest grace; nothing can be started any more.

        The knowledge base that was last given to `observe` is told.
        """
        with self._lock:
            if (
                not self._is_open or os.getpid() != self._owner
            ):  # a forked process owns none of them
                return
            self._is_open = False
            atexit.unregister(self.close)
            left, deadline = (
                list(self._handles.values()),
                time.monotonic() + self._grace + _TO_DIE_S,
            )
            while (
                left := [handle for handle in left if not handle.stop()]
            ) and time.monotonic() < deadline:
                time.sleep(0.01)
            for one in (self._guardian, *self._tidiers.values()):
                if one is not None:
                    _dismiss(one, self._grace)
            for handle in self._handles.values():
                handle.output.catch_up()
            if self._private is not None:
                shutil.rmtree(self._private, ignore_errors=True)
        try:  # closing raises no error when the knowledge base can be told nothing any more
            if (kb := self._observed) is not None:
                self._tell(kb)
                for name in (one for one in self._handles if one in kb.components):
                    kb.component_active(
                        name, False, f"the process of {name} was ended with all others"
                    )
        except KnowledgeBaseError as error:
            _log.warning("the knowledge base was not told that the processes have ended: %s", error)

    def __exit__(self, *_: object) -> None:
        self.close()

    def _handle(self, component: str) -> "_Handle":
        if component not in self._handles:
            raise UnknownName("process component", component, self._handles)
        return self._handles[component]

    def _pids(self) -> dict[str, int]:
        with self._lock:
            for handle in self._handles.values():
                handle.look()
            return {
                name: one.process.pid
                for name, one in self._handles.items()
                if one.process is not None
            }

    def _meet(self, kb: KnowledgeBase) -> None:
        mine = self._pids()
        for process in kb.processes:
            name, pid = process.component, process.pid
            if name in self._handles and process.end is None and mine.get(name) != pid:
                self._tidy_up(name, pid)
                kb.component_ended(name, pid)
        for name in self._handles:
            kb.component_active(
                name, name in mine, "" if name in mine else f"the process of {name} is no more"
            )

    def _tidy_up(self, component: str, pid: int) -> None:
        """End a process that an earlier program left over; its component starts only after that."""
        mark = guardian.left_over(pid)
        if mark is None:
            return
        with self._lock:
            self._handles[component].predecessors[pid] = guardian.started(pid)
            if self._is_open and mark not in self._tidiers:
                _log.warning("the process of %s, %d, was left over and is ended", component, pid)
                self._tidiers[mark] = _guard(mark, self._grace, parent=0)  # it begins at once

    def _tell(self, kb: KnowledgeBase) -> None:
        with self._lock:
            self._pids()
            reports = tuple(self._reports)
            self._reports.clear()
        for verb, arguments in reports:
            if arguments[0] in kb.components:
                getattr(kb, verb)(*arguments)


class Output:
    """Keeps the newest output in FILE and older output in FILE.1, half of `MOST` each; other users cannot read them.

    FILE, the path, is created anew, and never through a symbolic link.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._source: IO[bytes] | None = None
        self._reading = Lock()
        self._size, self._tail = 0, b""

    def follow(self, source: IO[bytes]) -> None:
        """Read from a pipe in a thread until all its writers have closed it; then close it."""
        os.set_blocking(source.fileno(), False)
        self._source, self._tail = source, b""
        Thread(
            target=self._follow, args=(source,), name=f"output to {self.path.name}", daemon=True
        ).start()

    def catch_up(self) -> None:
        """Read what the pipe holds now, which is all that an ended process wrote; others may still write to it."""
        if self._source is not None:
            self._read(self._source)

    def last_lines(self) -> str:
        """Return the last lines of the output, joined by " | "; empty if there is none."""
        self.catch_up()
        text = self._tail.decode("utf-8", "replace")
        lines = [
            "".join(one for one in line if one.isprintable()).strip()[:_WIDTH]
            for line in text.splitlines()
        ]
        return " | ".join([line for line in lines if line][-_LINES:])

    def _follow(self, source: IO[bytes]) -> None:
        written = poll()
        written.register(source, POLLIN)
        while self._read(source):
            written.poll()
        with self._reading:
            source.close()  # only here, because this thread waits for it

    def _read(self, source: IO[bytes]) -> bool:
        """Read what the pipe holds, at most 64 KiB; return whether more may come."""
        with self._reading:
            left = _CHUNK
            while left > 0 and not source.closed:
                data = source.read(left)
                if not data:
                    return data is None
                left -= len(data)
                self._keep(data)
            return not source.closed

    def _keep(self, data: bytes) -> None:
        self._tail = (self._tail + data)[-_TAIL:]
        try:
            self._write(data)
        except OSError as error:  # e.g. a full disk, which must not stop a component
            _log.warning("output to %s is lost: %s", self.path, error.strerror)

    def _write(self, data: bytes) -> None:
        if not 0 < self._size <= MOST // 2 - len(data):
            with suppress(FileNotFoundError):
                self.path.replace(f"{self.path}.1")
            self._size = 0
        with FileIO(self.path, "a" if self._size else "x", opener=_opened) as file:
            self._size += file.write(data)


def _opened(path: str, how: int) -> int:
    return os.open(path, how | os.O_NOFOLLOW, 0o600)


@dataclass(slots=True, eq=False)
class _Handle:
    """The process of a component as it starts, runs and ends; each call does what it can without waiting."""

    name: str
    program: Program
    reports: deque[_Report]
    output: Output
    process: subprocess.Popen[bytes] | None = None
    crash: tuple[int, str] = (
        -1,
        "",
    )  # pid of the process that last ended by itself, and how, in words
    predecessors: dict[int, int | None] = field(
        default_factory=dict
    )  # pid and start of what must end first
    _parameters: Parameters = field(default_factory=dict)
    _in_force: Parameters = field(default_factory=dict)
    _started: float = 0.0
    _kill_at: float | None = None
    _crashes: int = 0
    _not_before: float = 0.0

    def set_parameters(self, parameters: Parameters) -> None:
        self.look()
        pid = None if self.process is None else self.process.pid
        if self.program.configure is not None:
            self.program.configure(parameters, pid)
        elif pid is not None and parameters != self._in_force:
            raise KnowledgeBaseError(
                f"{self.name!r} takes no parameters while it runs; declare the component with "
                f"stops_to_configure=True, or give its Program a function configure"
            )
        else:
            self.program.command(parameters)
        self._parameters = parameters

    def start(self, mark: str) -> int | None:
        """Do the next step of a start; return the pid once the process runs."""
        self.look()
        left = {pid: began for pid, began in self.predecessors.items() if began is not None}
        self.predecessors = {
            pid: began for pid, began in left.items() if guardian.started(pid) == began
        }
        if self.process is None and time.monotonic() >= self._not_before and not self.predecessors:
            self._spawn(mark)
        return None if self.process is None or self._kill_at is not None else self.process.pid

    def stop(self) -> bool:
        """Do the next step of an end; return whether the process has ended."""
        self.look()
        if self.process is None:
            self._crashes, self._not_before = 0, 0.0
        elif self._kill_at is None:
            self._kill_at = time.monotonic() + self.program.grace
            _signal_group(self.process.pid, signal.SIGTERM)
        return self.process is None

    def look(self) -> None:
        process = self.process
        if process is None:
            return
        is_over = _has_ended(process.pid)
        if self._kill_at is None:
            if is_over:
                self._note_crash(process)
        elif is_over and not guardian.has_others(process.pid):
            self._bury(process)
        elif time.monotonic() >= self._kill_at:
            _signal_group(process.pid, signal.SIGKILL)

    def _spawn(self, mark: str) -> None:
        program = self.program
        program.check()
        command, variables = program.command(self._parameters), program.variables(self._parameters)
        environment, no_input = {**os.environ, **variables, guardian.MARK: mark}, subprocess.DEVNULL
        try:
            self.process = subprocess.Popen(
                command,
                bufsize=0,
                cwd=program.directory,
                env=environment,
                stdin=no_input,
                stdout=subprocess.PIPE,
                stderr=subprocess.STDOUT,
                start_new_session=True,
            )
        except OSError as error:
            remedy = "see whether its first line names an interpreter that is there"
            raise KnowledgeBaseError(
                f"{command[0]!r} cannot be run: {error.strerror}; {remedy}"
            ) from None
        assert self.process.stdout is not None
        self.output.follow(self.process.stdout)
        self._started, self._in_force, self.crash = time.monotonic(), self._parameters, (-1, "")
        self._report("component_started", self.process.pid)

    def _note_crash(self, process: subprocess.Popen[bytes]) -> None:
        _signal_group(process.pid, signal.SIGKILL)  # ends the rest of the group
        self._bury(process)
        code, signals = process.returncode, {one.value: one.name for one in signal.Signals}
        manner = f"exit status {code}" if code >= 0 else signals.get(-code, f"signal {-code}")
        now, reason = time.monotonic(), f"the process of {self.name} ended by itself ({manner})"
        if words := self.output.last_lines():
            reason += f"; it last wrote: {words}"
        self.crash = (process.pid, reason)
        _log.warning("%s", reason)
        self._report("component_active", False, reason)
        if now - self._started >= _STEADY_S:
            self._crashes = 0
        self._crashes += 1
        if self._crashes > self.program.restarts:
            self._crashes, self._not_before = 0, 0.0
            self._report("component_failed", reason)
        else:
            self._not_before = now + self.program.back_off * 2.0 ** min(self._crashes - 1, 60)

    def _bury(self, process: subprocess.Popen[bytes]) -> None:
        process.wait()
        self.process, self._kill_at = None, None
        self._report("component_ended", process.pid)

    def _report(self, verb: str, *arguments: object) -> None:
        self.reports.append((verb, (self.name, *arguments)))


def _has_ended(pid: int) -> bool:
    """Return whether a child has ended; it is not reaped, so its pid is not used again."""
    try:
        return os.waitid(os.P_PID, pid, os.WEXITED | os.WNOHANG | os.WNOWAIT) is not None
    except ChildProcessError:
        return True


def _signal_group(leader: int, number: signal.Signals) -> None:
    with suppress(
        ProcessLookupError, PermissionError
    ):  # it has ended, or belongs to another user now
        os.killpg(leader, number)


@dataclass(slots=True)
class _Switch:
    """The start of a component, or without a mark its end; see `Operation`."""

    handle: _Handle
    lock: RLock
    mark: str | None = None
    pid: int | None = None

    def __post_init__(self) -> None:
        self.done()  # does the first step

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


def _guard(mark: str, grace: float, parent: int) -> subprocess.Popen[bytes]:
    return subprocess.Popen(
        [sys.executable, "-I", "-S", guardian.__file__, mark, str(grace), str(parent)],
        stdin=subprocess.PIPE,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        env={name: value for name, value in os.environ.items() if name != guardian.MARK},
        start_new_session=True,
    )


def _dismiss(one: subprocess.Popen[bytes], grace: float) -> None:
    """Tell a guardian to end processes outside of their groups and then itself."""
    assert one.stdin is not None
    one.stdin.close()
    try:
        one.wait(grace + _TO_DIE_S)
    except subprocess.TimeoutExpired:
        one.kill()
        one.wait()
