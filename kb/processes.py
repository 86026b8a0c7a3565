"""Components that are processes: plain programs, and ROS nodes by `ros2 run`."""

import atexit
import json
import logging
import math
import os
import re
import shutil
import signal
import subprocess
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

from kb.elements import ComponentKind, Parameters, is_number
from kb.exceptions import InvalidValue, KnowledgeBaseError, UnknownName
from kb.knowledge_base import KnowledgeBase
from kb.managed_system import Operation
from kb.views import ComponentView

_log = logging.getLogger(__name__)
_PLACEHOLDER: Final = re.compile(r"\{([^\W\d]\w*)\}")


@dataclass(frozen=True, slots=True)
class Program:
    """The program of a component.

    Attributes:
        arguments: the executable and its arguments; no shell reads them. `{name}` stands for the
            parameter of that name.
        environment: variables in addition to those of this process.
        directory: where it runs; None for where this process is.
        grace_s: how long it may take to end after SIGTERM [s]; then it is killed.
        configure: called with new parameters while it runs, may return an operation; without it,
            new parameters count from the next start on.
        is_ros_node: parameters are added as `-p name:=value`.
    """

    arguments: Sequence[str]
    environment: Mapping[str, str] = field(default_factory=dict)
    directory: str | Path | None = None
    grace_s: float = 5.0
    configure: Callable[[Parameters], Operation | None] | None = None
    is_ros_node: bool = False

    def __post_init__(self) -> None:
        if isinstance(self.arguments, str) or not self.arguments:
            raise InvalidValue(
                "arguments are a list that begins with the executable, e.g. "
                f'["node", "--quiet"], not {self.arguments!r}; no shell takes them apart'
            )
        for text in (*self.arguments, *self.environment, *self.environment.values()):
            if not isinstance(text, str) or "\0" in text:
                raise InvalidValue(
                    f"arguments and variables are text without null characters, not {text!r}"
                )
        if not is_number(self.grace_s) or not 0 <= self.grace_s < math.inf:
            raise InvalidValue(f"grace_s is a finite time in seconds from 0, not {self.grace_s!r}")

    def check(self) -> None:
        """Raise `InvalidValue` if the executable or the directory is missing on this machine."""
        directory = Path(self.directory or ".")
        if not directory.is_dir():
            raise InvalidValue(
                f"there is no directory {str(directory)!r}; create it or name another"
            )
        name = self.arguments[0]
        path = self.environment.get("PATH", os.environ.get("PATH"))
        if shutil.which(directory.absolute() / name if os.sep in name else name, path=path) is None:
            raise InvalidValue(
                f"there is no executable {name!r}; install it, correct the path, or chmod +x it"
            )

    def command(self, parameters: Parameters) -> list[str]:
        """Return the arguments with parameters in place; `KnowledgeBaseError` if one is missing."""
        command = [_filled_in(argument, parameters) for argument in self.arguments]
        if self.is_ros_node:
            for name, value in parameters.items():
                command += ["-p", f"{name}:={json.dumps(value)}"]
        return command


def ros_node(
    package: str,
    executable: str,
    name: str = "",
    **options: Any,  # noqa: ANN401  # of Program
) -> Program:
    """Return the program `ros2 run package executable`; a name renames the node."""
    arguments = ["ros2", "run", package, executable, "--ros-args"]
    if name:
        arguments += ["-r", f"__node:={name}"]
    return Program(arguments, is_ros_node=True, **options)


def ros_node_programs(components: Iterable[ComponentView]) -> dict[str, Program]:
    """Return the programs of those components that are ROS nodes without a lifecycle, by name.

    These are the components of kind "ros_node" or "process" with a package and an executable.
    """
    return {
        component.name: ros_node(component.package, component.executable)
        for component in components
        if component.kind not in (ComponentKind.PLAIN, ComponentKind.LIFECYCLE)
        and component.package
        and component.executable
    }


def _filled_in(text: str, parameters: Parameters) -> str:
    def value_of(placeholder: re.Match[str]) -> str:
        name = placeholder[1]
        if name not in parameters:
            names = ", ".join(map(repr, parameters)) or "none"
            raise KnowledgeBaseError(f"{text!r} needs the parameter {name!r}; there are: {names}")
        value = parameters[name]
        return value if isinstance(value, str) else json.dumps(value)

    return _PLACEHOLDER.sub(value_of, text)


@dataclass(slots=True, eq=False)
class _Process:
    popen: "subprocess.Popen[bytes]"
    parameters: Parameters
    kill_at: float | None = None
    is_killed: bool = False

    def terminate(self, grace_s: float) -> None:
        self.kill_at = time.monotonic() + grace_s
        self.signal_group(signal.SIGTERM)

    def has_ended(self) -> bool:
        """Return whether the whole group has ended; kill it after its grace."""
        if self.popen.poll() is not None and (self.is_killed or not self.signal_group(0)):
            return True
        if self.kill_at is not None and time.monotonic() >= self.kill_at:
            self.signal_group(signal.SIGKILL)
            self.is_killed = True
        return False

    def signal_group(self, number: int) -> bool:
        """Return whether the group still has a process."""
        try:
            os.killpg(self.popen.pid, number)
        except (ProcessLookupError, PermissionError):
            return False
        return True

    @property
    def ending(self) -> str:
        code = self.popen.returncode
        if code >= 0:
            return f"with exit status {code}"
        names = {number.value: number.name for number in signal.Signals}
        return f"by {names.get(-code, f'signal {-code}')}"


@dataclass(frozen=True, slots=True)
class _Termination:
    """The operation of ending a process."""

    process: _Process

    def done(self) -> bool:
        return self.process.has_ended()

    def exception(self) -> None:
        return None


class ProcessComponents(AbstractContextManager["ProcessComponents"]):
    """A managed system of processes, which notices those that end by themselves.

    Each process runs in a process group of its own. It is asked to end with SIGTERM, and the group
    is killed after its grace. What it writes goes where the output of this program goes. The
    manager calls `observe` at each turn; so the knowledge base knows what was started and has
    ended. Close it, or use it in a `with` statement. If this program is killed, its processes go
    on.

    Args:
        programs: what to run, by name of the component.

    Raises:
        InvalidValue: one of the programs cannot be run on this machine.
    """

    def __init__(self, programs: Mapping[str, Program]) -> None:
        for name, program in programs.items():
            if not isinstance(program, Program):
                raise InvalidValue(f"component {name!r} is run as a kb.Program, not as {program!r}")
            try:
                program.check()
            except InvalidValue as error:
                raise InvalidValue(f"component {name!r} cannot be run: {error}") from None
        self._programs = dict(programs)
        self._parameters: dict[str, Parameters] = {}
        self._processes: dict[str, _Process] = {}
        self._unrecorded: list[tuple[str, str, int]] = []
        self._kb: KnowledgeBase | None = None
        atexit.register(self.close)

    def activate(self, component: str, /) -> None:
        """Start a component; one that runs goes on."""
        program = self._program(component)
        parameters = self._parameters.get(component, {})
        process = self._processes.get(component)
        if process is not None and process.kill_at is None:
            return
        if process is not None and not self._is_gone(component, process):
            raise KnowledgeBaseError(f"the last process of {component!r} is still ending")
        command = program.command(parameters)
        try:
            popen = subprocess.Popen(
                command,
                cwd=program.directory,
                env={**os.environ, **program.environment},
                stdin=subprocess.DEVNULL,
                start_new_session=True,
            )
        except OSError as error:
            raise KnowledgeBaseError(
                f"{command[0]!r} cannot be run: {error.strerror}; if it is a script, see "
                "whether its first line names an interpreter that is there"
            ) from None
        self._processes[component] = _Process(popen, parameters)
        self._unrecorded.append(("component_started", component, popen.pid))

    def deactivate(self, component: str, /) -> Operation | None:
        """End a component with SIGTERM, and kill its process group after its grace."""
        program = self._program(component)
        process = self._processes.get(component)
        if process is None:
            return None
        if process.kill_at is None:
            process.terminate(program.grace_s)
        return _Termination(process)

    def set_parameters(self, component: str, parameters: Parameters, /) -> Operation | None:
        """Set the parameters; without `configure` they count from the next start on."""
        program = self._program(component)
        program.command(parameters)
        process = self._processes.get(component)
        operation = None
        if process is not None and program.configure is not None:
            operation = program.configure(parameters)
        elif process is not None and process.kill_at is None and parameters != process.parameters:
            raise KnowledgeBaseError(
                f"{component!r} takes no parameters while it runs; declare the component with "
                "stops_to_configure=True, or give its Program a function configure"
            )
        self._parameters[component] = dict(parameters)
        return operation

    def is_active(self, component: str, /) -> bool:
        """Return whether a component runs; one that crashed does until `observe` records it."""
        self._program(component)
        process = self._processes.get(component)
        return process is not None and process.kill_at is None

    def observe(self, kb: KnowledgeBase) -> None:
        """Record what was started and what has ended since the last time.

        Processes that an earlier program recorded in the same knowledge base are recorded as
        ended.

        Raises:
            UnknownName: a program is for a component that the model does not have; the first time
                only.
        """
        if kb is not self._kb:
            self._kb = kb
            self._adopt(kb)
        self._record(kb)
        for component, process in list(self._processes.items()):
            if process.kill_at is not None:
                self._is_gone(component, process)
            elif process.popen.poll() is not None:
                self._record_exit(kb, component, process)
        self._record(kb)

    def close(self) -> None:
        """End all processes, wait for them, and record it in the knowledge base."""
        atexit.unregister(self.close)
        for component, process in self._processes.items():
            if process.kill_at is None:
                process.terminate(self._programs[component].grace_s)
        stopped = list(self._processes)
        while self._processes:
            for component, process in list(self._processes.items()):
                self._is_gone(component, process)
            time.sleep(0.01)
        if self._kb is None:
            return
        try:
            self._record(self._kb)
            for component in stopped:
                reason = f"the process of {component} was ended with all others"
                self._kb.component_active(component, False, reason)
        except KnowledgeBaseError as error:
            _log.warning("the end of the processes was not recorded: %s", error)

    def __exit__(self, *_: object) -> None:
        self.close()

    def _program(self, component: str) -> Program:
        if component not in self._programs:
            raise UnknownName("process component", component, self._programs)
        return self._programs[component]

    def _is_gone(self, component: str, process: _Process) -> bool:
        if not process.has_ended():
            return False
        if self._processes.get(component) is process:
            del self._processes[component]
            self._unrecorded.append(("component_ended", component, process.popen.pid))
        return True

    def _record(self, kb: KnowledgeBase) -> None:
        while self._unrecorded:
            verb, component, pid = self._unrecorded.pop(0)
            if component not in kb.components:  # it was removed from the model
                continue
            if verb == "component_started":
                kb.component_started(component, pid)
            else:
                kb.component_ended(component, pid)

    def _record_exit(self, kb: KnowledgeBase, component: str, process: _Process) -> None:
        process.signal_group(signal.SIGKILL)  # ends the rest of the group
        del self._processes[component]
        self._unrecorded.append(("component_ended", component, process.popen.pid))
        reason = f"the process of {component} ended by itself {process.ending}"
        _log.warning("%s", reason)
        if component in kb.components:
            kb.component_active(component, False, reason)
            kb.component_failed(component, reason)

    def _adopt(self, kb: KnowledgeBase) -> None:
        pids = {process.popen.pid for process in self._processes.values()}
        for component in self._programs:
            if component not in self._processes and kb.components[component].is_active:
                kb.component_active(component, False, f"the process of {component} is no more")
        for record in kb.history.processes:
            if record.component in self._programs and record.end is None and record.pid not in pids:
                kb.component_ended(record.component, record.pid)
