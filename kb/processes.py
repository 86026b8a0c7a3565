"""Components that are processes: plain programs, and ROS nodes by `ros2 run`."""

import atexit
import json
import logging
import os
import re
import shutil
import signal
import subprocess
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from typing import Final

from kb.elements import ComponentKind, Parameters
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
        grace_s: how long it may take to end after SIGTERM [s]; then it is killed.
        configure: called with new parameters while it runs, may return an operation; without it,
            new parameters count from the next start on.
        is_ros_node: parameters are added as `-p name:=value`.
    """

    arguments: Sequence[str]
    grace_s: float = 5.0
    configure: Callable[[Parameters], Operation | None] | None = None
    is_ros_node: bool = False

    def __post_init__(self) -> None:
        if isinstance(self.arguments, str) or not self.arguments:
            raise InvalidValue(
                "arguments are a list that begins with the executable, e.g. "
                f'["node", "--quiet"], not {self.arguments!r}; no shell takes them apart'
            )

    def command(self, parameters: Parameters) -> list[str]:
        """Return the arguments with parameters in place; `KnowledgeBaseError` if one is missing."""

        def value_of(placeholder: re.Match[str]) -> str:
            name = placeholder[1]
            if name not in parameters:
                names = ", ".join(map(repr, parameters)) or "none"
                text = placeholder.string
                raise KnowledgeBaseError(
                    f"{text!r} needs the parameter {name!r}; there are: {names}"
                )
            value = parameters[name]
            return value if isinstance(value, str) else json.dumps(value)

        command = [_PLACEHOLDER.sub(value_of, argument) for argument in self.arguments]
        if self.is_ros_node:
            for name, value in parameters.items():
                command += ["-p", f"{name}:={json.dumps(value)}"]
        return command


def ros_node(package: str, executable: str, name: str = "") -> Program:
    """Return the program `ros2 run package executable`; a name renames the node."""
    arguments = ["ros2", "run", package, executable, "--ros-args"]
    if name:
        arguments += ["-r", f"__node:={name}"]
    return Program(arguments, is_ros_node=True)


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


@dataclass(slots=True, eq=False)
class _Process:
    """A process; once it is asked to end, it is the operation of ending it, too."""

    popen: "subprocess.Popen[bytes]"
    parameters: Parameters
    kill_at: float | None = None
    is_recorded: bool = False

    def terminate(self, grace_s: float) -> None:
        if self.kill_at is None:
            self.kill_at = time.monotonic() + grace_s
            self.signal_group(signal.SIGTERM)

    def done(self) -> bool:
        """Return whether the whole group has ended; kill it after its grace."""
        if self.popen.poll() is not None and not self.signal_group(0):
            return True
        if self.kill_at is not None and time.monotonic() >= self.kill_at:
            self.signal_group(signal.SIGKILL)
            return self.popen.poll() is not None
        return False

    def exception(self) -> None:
        return None

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
        return f"with exit status {code}" if code >= 0 else f"by {signal.Signals(-code).name}"


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
        InvalidValue: one of the executables is not on this machine.
    """

    def __init__(self, programs: Mapping[str, Program]) -> None:
        for name, program in programs.items():
            if not isinstance(program, Program):
                raise InvalidValue(f"component {name!r} is run as a kb.Program, not as {program!r}")
            executable = program.arguments[0]
            if shutil.which(executable) is None:
                raise InvalidValue(
                    f"component {name!r} cannot be run: there is no executable {executable!r}; "
                    "install it, correct the path, or chmod +x it"
                )
        self._programs = dict(programs)
        self._parameters: dict[str, Parameters] = {}
        self._processes: dict[str, _Process] = {}
        self._ended: list[tuple[str, _Process]] = []
        self._kb: KnowledgeBase | None = None
        atexit.register(self.close)

    def activate(self, component: str, /) -> None:
        """Start a component; one that runs goes on."""
        program = self._program(component)
        process = self._processes.get(component)
        if process is not None and process.kill_at is None:
            return
        if process is not None:
            if not process.done():
                raise KnowledgeBaseError(f"the last process of {component!r} is still ending")
            self._ended.append((component, process))
        parameters = self._parameters.get(component, {})
        command = program.command(parameters)
        try:
            popen = subprocess.Popen(command, stdin=subprocess.DEVNULL, start_new_session=True)
        except OSError as error:
            raise KnowledgeBaseError(
                f"{command[0]!r} cannot be run: {error.strerror}; if it is a script, see "
                "whether its first line names an interpreter that is there"
            ) from None
        self._processes[component] = _Process(popen, parameters)

    def deactivate(self, component: str, /) -> Operation | None:
        """End a component with SIGTERM, and kill its process group after its grace."""
        program = self._program(component)
        process = self._processes.get(component)
        if process is not None:
            process.terminate(program.grace_s)
        return process

    def set_parameters(self, component: str, parameters: Parameters, /) -> Operation | None:
        """Set the parameters; without `configure` they count from the next start on."""
        program = self._program(component)
        program.command(parameters)
        operation = None
        if self.is_active(component):
            if program.configure is not None:
                operation = program.configure(parameters)
            elif parameters != self._processes[component].parameters:
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
            for component in self._programs:
                if kb.components[component].is_active and component not in self._processes:
                    reason = f"the process of {component} is no more"
                    kb.component_active(component, False, reason)
                kb.component_ended(component)
        self._record(kb)

    def close(self) -> None:
        """End all processes, wait for them, and record it in the knowledge base."""
        atexit.unregister(self.close)
        for component, process in self._processes.items():
            process.terminate(self._programs[component].grace_s)
        stopped = list(self._processes)
        while not all(process.done() for process in self._processes.values()):
            time.sleep(0.01)
        kb = self._kb
        if kb is None:
            self._processes.clear()
            return
        try:
            self._record(kb)
            for component in stopped:
                reason = f"the process of {component} was ended with all others"
                kb.component_active(component, False, reason)
        except KnowledgeBaseError as error:
            _log.warning("the end of the processes was not recorded: %s", error)

    def __exit__(self, *_: object) -> None:
        self.close()

    def _program(self, component: str) -> Program:
        if component not in self._programs:
            raise UnknownName("process component", component, self._programs)
        return self._programs[component]

    def _record(self, kb: KnowledgeBase) -> None:
        for component, process in [*self._ended, *self._processes.items()]:
            is_current = self._processes.get(component) is process
            has_crashed = process.kill_at is None and process.popen.poll() is not None
            if has_crashed:
                process.signal_group(signal.SIGKILL)  # ends the rest of the group
            has_ended = has_crashed or process.done()
            if has_ended and is_current:
                del self._processes[component]
            if component not in kb.components:  # it was removed from the model
                continue
            pid = process.popen.pid
            if not process.is_recorded:
                process.is_recorded = True
                kb.component_started(component, pid)
            if has_ended:
                kb.component_ended(component, pid)
            if has_crashed:
                reason = f"the process of {component} ended by itself {process.ending}"
                _log.warning("%s", reason)
                kb.component_active(component, False, reason)
                kb.component_failed(component, reason)
        self._ended.clear()
