"""Components that are processes: plain programs, and ROS nodes by `ros2 run`."""

import atexit
import json
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

from kb.elements import ByName, ComponentKind, Parameters
from kb.exceptions import InvalidValue, KnowledgeBaseError, UnknownName
from kb.knowledge_base import KnowledgeBase
from kb.managed_system import Operation
from kb.views import ComponentView

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
        """Return the arguments with parameters in place; `UnknownName` if one is missing."""

        def text_of(placeholder: re.Match[str]) -> str:
            name = placeholder[1]
            if name not in parameters:
                raise UnknownName(f"parameter of {placeholder.string!r}", name, parameters)
            value = parameters[name]
            return value if isinstance(value, str) else json.dumps(value)

        command = [_PLACEHOLDER.sub(text_of, argument) for argument in self.arguments]
        if self.is_ros_node:
            for name, value in parameters.items():
                command += ["-p", f"{name}:={json.dumps(value)}"]
        return command


def ros_node(package: str, executable: str) -> Program:
    """Return the program `ros2 run package executable`."""
    return Program(["ros2", "run", package, executable, "--ros-args"], is_ros_node=True)


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


@dataclass(eq=False)
class _Process:
    """A process that leads a group of its own, and the operation of ending that group."""

    popen: subprocess.Popen[bytes]
    parameters: Parameters
    kill_at: float | None = None

    def terminate(self, grace_s: float) -> None:
        if self.kill_at is None:
            self.kill_at = time.monotonic() + grace_s
            self.signal_group(signal.SIGTERM)

    def done(self) -> bool:
        """Return whether the whole group has ended; kill it after its grace."""
        has_ended = self.popen.poll() is not None
        is_killed = self.kill_at is not None and time.monotonic() >= self.kill_at
        is_group_left = self.signal_group(signal.SIGKILL if is_killed else 0)
        return has_ended and (is_killed or not is_group_left)

    def exception(self) -> None:
        return None

    def signal_group(self, number: int) -> bool:
        """Return whether the group still has a process."""
        try:
            os.killpg(self.popen.pid, number)
        except (ProcessLookupError, PermissionError):
            return False
        return True


class ProcessComponents(AbstractContextManager["ProcessComponents"]):
    """A managed system of processes, which notices those that end by themselves.

    Each process runs in a process group of its own. It is asked to end with SIGTERM, and the group
    is killed after its grace. What it writes goes where the output of this program goes. The
    manager calls `observe` at each turn; so the knowledge base knows what has ended. Close it, or
    use it in a `with` statement. If this program is killed, its processes go on.

    Args:
        programs: what to run, by name of the component.

    Raises:
        InvalidValue: one of the executables is not on this machine.
    """

    def __init__(self, programs: Mapping[str, Program]) -> None:
        for name, program in programs.items():
            executable = program.arguments[0]
            if shutil.which(executable) is None:
                raise InvalidValue(
                    f"component {name!r} cannot be run: there is no executable {executable!r}; "
                    "install it, correct the path, or chmod +x it"
                )
        self._programs = ByName("process component", programs)
        self._parameters: dict[str, Parameters] = {}
        self._processes: dict[str, _Process] = {}
        self._owner = os.getpid()
        atexit.register(self.close)

    def activate(self, component: str, /) -> None:
        """Start a component; one that runs goes on."""
        if self.is_active(component):
            return
        process = self._processes.get(component)
        if process is not None and not process.done():
            raise KnowledgeBaseError(f"the last process of {component!r} is still ending")
        parameters = self._parameters.get(component, {})
        command = self._programs[component].command(parameters)
        popen = subprocess.Popen(command, stdin=subprocess.DEVNULL, start_new_session=True)
        self._processes[component] = _Process(popen, parameters)

    def deactivate(self, component: str, /) -> Operation | None:
        """End a component with SIGTERM, and kill its process group after its grace."""
        program = self._programs[component]
        process = self._processes.get(component)
        if process is not None:
            process.terminate(program.grace_s)
        return process

    def set_parameters(self, component: str, parameters: Parameters, /) -> Operation | None:
        """Set the parameters; without `configure` they count from the next start on."""
        program = self._programs[component]
        program.command(parameters)  # refuses them if one is missing
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
        _ = self._programs[component]
        process = self._processes.get(component)
        return process is not None and process.kill_at is None

    def observe(self, kb: KnowledgeBase) -> None:
        """Record what has ended by itself since the last time as failed."""
        for component, process in list(self._processes.items()):
            code = process.popen.poll()
            if code is None or process.kill_at is not None:
                continue
            process.signal_group(signal.SIGKILL)  # ends the rest of the group
            del self._processes[component]
            ending = f"with exit status {code}"
            if code < 0:
                ending = f"by signal {-code} ({signal.strsignal(-code)})"
            reason = f"the process of {component} ended by itself {ending}"
            kb.component_active(component, False, reason)
            kb.component_failed(component, reason)

    def close(self) -> None:
        """End all processes, and wait for them; in a forked child they go on."""
        if os.getpid() == self._owner:
            for component in self._processes:
                self.deactivate(component)
            while not all(process.done() for process in self._processes.values()):
                time.sleep(0.01)
            self._processes.clear()
        atexit.unregister(self.close)

    def __exit__(self, *_: object) -> None:
        self.close()
