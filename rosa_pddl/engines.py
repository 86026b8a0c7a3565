"""Planners by others, each in a process of its own: Fast Downward, Kairos, and unified-planning's.

Fast Downward runs as a program; it is licensed under the GPL-3, so nothing of it is imported here.
Kairos runs in a worker that stays: it has read the domain, and a question is a problem's text.
"""

import atexit
import json
import os
import re
import resource
import select
import signal
import subprocess
import sys
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Future, InvalidStateError
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from tempfile import TemporaryDirectory, TemporaryFile
from threading import Lock
from typing import IO, Any, Final, NamedTuple
from weakref import WeakSet

from rosa_pddl.exceptions import nearest
from rosa_pddl.problem import Outcome, PddlText, PlanningFailed

OPTIMAL: Final = "fast-downward-opt"
FAST: Final = "fast-downward"
KAIROS: Final = "kairos"
DOWNWARD: Final = (OPTIMAL, FAST)

_INSTALL = "try 'pip install --force-reinstall up-fast-downward'"
# A plan of a million steps is smaller than this; an engine that writes more prints without end.
_MOST_OUTPUT = 64 << 20
_LOOKS_S = 0.05
_GRACE_S = 2.0
_POLL_S = 0.0003
_MOST_DOMAINS = 8
_NO_PYTHON_NOISE = {"PYTHONWARNINGS": "ignore", "PYTHONHASHSEED": "0"}
_EXIT_CODES = {
    10: Outcome.UNSOLVABLE_PROVEN,
    11: Outcome.UNSOLVABLE_PROVEN,
    12: Outcome.UNSOLVABLE_AS_FAR_AS_KNOWN,
    20: Outcome.OUT_OF_MEMORY,
    21: Outcome.OUT_OF_TIME,
    22: Outcome.OUT_OF_MEMORY,
    23: Outcome.OUT_OF_TIME,
    34: Outcome.UNSUPPORTED,
}
# What unified-planning and Kairos call their outcomes.
_OUTCOMES = {
    "SOLVED_SATISFICING": Outcome.SOLVED,
    "SOLVED_OPTIMALLY": Outcome.SOLVED_OPTIMALLY,
    "UNSOLVABLE_PROVEN": Outcome.UNSOLVABLE_PROVEN,
    "UNSOLVABLE_INCOMPLETELY": Outcome.UNSOLVABLE_AS_FAR_AS_KNOWN,
    "MEMOUT": Outcome.OUT_OF_MEMORY,
    "UNSUPPORTED_PROBLEM": Outcome.UNSUPPORTED,
    "SOLVED": Outcome.SOLVED,
    "UNSOLVABLE": Outcome.UNSOLVABLE_PROVEN,
    "NO_PLAN_FOUND": Outcome.UNSOLVABLE_AS_FAR_AS_KNOWN,
    "TIMEOUT": Outcome.OUT_OF_TIME,
    "CANCELLED": Outcome.OUT_OF_TIME,
    "OUT_OF_MEMORY": Outcome.OUT_OF_MEMORY,
    "GROUNDING_TOO_LARGE": Outcome.OUT_OF_MEMORY,
    "UNSUPPORTED": Outcome.UNSUPPORTED,
    "INVALID_INPUT": Outcome.UNSUPPORTED,
}


class EngineStep(NamedTuple):
    """A step as an engine gives it: the action in the text, its arguments, and its times [s]."""

    action: str
    arguments: tuple[str, ...]
    start_s: float = 0.0
    duration_s: float = 0.0


class EngineAnswer(NamedTuple):
    """How an engine ended, with its plan."""

    outcome: Outcome
    steps: tuple[EngineStep, ...] = ()
    message: str = ""


class Cancelled(Exception):
    """The answer is no longer wanted; raised where a program runs or would start."""


# ---------------------------------------------------------------- programs


@dataclass(frozen=True)
class Ended:
    """A program that has ended: its exit code, or minus the signal that killed it, and output."""

    code: int
    output: bytes
    complaints: bytes

    @property
    def last_words(self) -> str:
        """The last lines of its output."""
        text = (self.output[-2000:] + b"\n" + self.complaints[-2000:]).decode(errors="replace")
        clean = "".join(c if c.isprintable() or c == "\n" else "?" for c in text)
        lines = [line.strip() for line in clean.splitlines() if line.strip()]
        return " / ".join(lines[-3:])[-400:] or "nothing"


class ProcessHandle:
    """Runs programs, one at a time; cancelling kills the running one, and none can start any more.

    Each program leads its own process group, which is killed after the program has ended for
    whatever reason: no child survives. The memory limit of a program is in bytes.
    """

    def __init__(self, memory_bytes: int | None = None) -> None:
        self.memory_bytes = memory_bytes
        self.is_running = False
        # a future, so that there is no lock that an interrupt could leave locked
        self._is_cancelled: Future[None] = Future()
        _HANDLES.add(self)

    def cancel(self) -> None:
        """End the running program, as its answer is no longer wanted. Returns at once."""
        with suppress(InvalidStateError):
            self._is_cancelled.set_result(None)

    @property
    def is_cancelled(self) -> bool:
        """Whether the answer is no longer wanted."""
        return self._is_cancelled.done()

    def check(self) -> None:
        """Raise Cancelled if the answer is no longer wanted."""
        if self.is_cancelled:
            raise Cancelled

    def run(
        self,
        command: Sequence[str],
        *,
        given: bytes = b"",
        limit_s: float,
        folder: str | None = None,
    ) -> Ended:
        """Run a program for at most `limit_s` of wall-clock time [s].

        Raises:
            Cancelled, PlanningFailed: the answer is not wanted, or the program fails.
        """
        with TemporaryFile() as read, TemporaryFile() as output, TemporaryFile() as complaints:
            read.write(given)
            read.seek(0)
            self.check()
            self.is_running = True
            try:
                process = _start(command, read, output, complaints, folder)
                try:
                    _limit(process.pid, limit_s, self.memory_bytes)
                    end = self._wait(process, limit_s, (output, complaints))
                finally:
                    # before it is reaped, as until then no other group can have its number
                    with suppress(ProcessLookupError):
                        os.killpg(process.pid, signal.SIGKILL)
                    process.wait()
            except OSError as error:
                message = f"it cannot be started ({error}); {_INSTALL}"
                raise PlanningFailed(Outcome.ENGINE_MISSING, message) from error
            finally:
                self.is_running = False
            self.check()
            ended = Ended(process.returncode, _content(output), _content(complaints))
        if end == "late":
            message = f"no answer after {limit_s:.3g} s; allow more time or ask for less"
            raise PlanningFailed(Outcome.OUT_OF_TIME, message)
        if end == "endless":
            message = f"it printed without end: {ended.last_words}"
            raise PlanningFailed(Outcome.ENGINE_CRASHED, message)
        return ended

    def _wait(
        self, process: subprocess.Popen[bytes], limit_s: float, outputs: Iterable[IO[bytes]]
    ) -> str:
        """Wait for a program; return why the waiting ended."""
        deadline = time.monotonic() + limit_s
        watched = tuple(outputs)
        descriptor = os.pidfd_open(process.pid)
        try:
            poll = select.poll()
            poll.register(descriptor, select.POLLIN)
            while (left_s := deadline - time.monotonic()) > 0.0:
                if poll.poll(min(left_s, _LOOKS_S) * 1e3):
                    return "itself"
                if any(os.fstat(file.fileno()).st_size > _MOST_OUTPUT for file in watched):
                    return "endless"
                if self.is_cancelled:
                    return "cancelled"
            return "late"
        finally:
            os.close(descriptor)


def _start(
    command: Sequence[str],
    read: int | IO[bytes],
    output: int | IO[bytes],
    complaints: int | IO[bytes],
    folder: str | None = None,
) -> subprocess.Popen[bytes]:
    paths = {"PYTHONPATH": os.pathsep.join(sys.path)}
    return subprocess.Popen(
        command,
        stdin=read,
        stdout=output,
        stderr=complaints,
        start_new_session=True,
        cwd=folder,
        env={**os.environ, **_NO_PYTHON_NOISE, **paths},
    )


def _content(file: IO[bytes]) -> bytes:
    return os.pread(file.fileno(), min(os.fstat(file.fileno()).st_size, _MOST_OUTPUT), 0)


def _limit(pid: int, limit_s: float, memory_bytes: int | None) -> None:
    with suppress(ProcessLookupError):
        # a limit of processor time also ends a program when this process has been killed
        seconds = int(limit_s + _GRACE_S)
        resource.prlimit(pid, resource.RLIMIT_CPU, (seconds, seconds))
        if memory_bytes is not None:
            resource.prlimit(pid, resource.RLIMIT_DATA, (memory_bytes, memory_bytes))


_HANDLES: WeakSet[ProcessHandle] = WeakSet()


@atexit.register
def _cancel_all() -> None:
    handles = tuple(_HANDLES)
    for handle in handles:
        handle.cancel()
    deadline = time.monotonic() + _GRACE_S
    while any(handle.is_running for handle in handles) and time.monotonic() < deadline:
        time.sleep(_LOOKS_S / 10)


# ---------------------------------------------------------------- Fast Downward


@cache
def fast_downward_command() -> tuple[str, ...]:
    """Return how Fast Downward is started; empty if it is not installed."""
    found = find_spec("up_fast_downward")
    if found is None or found.origin is None:
        return ()
    path = Path(found.origin).parent / "downward" / "fast-downward.py"
    return (sys.executable, str(path)) if path.exists() else ()


def fast_downward(
    text: PddlText, engine: str, process: ProcessHandle, limit_s: float
) -> EngineAnswer:
    """Search with Fast Downward, as unified-planning's engine of the same name does."""
    deadline = time.monotonic() + limit_s
    if engine == FAST:
        return _downward(text, ["--alias", "lama-first"], [], process, limit_s)
    answer = _downward(text, [], ["--search", "astar(lmcut())"], process, limit_s)
    if answer.outcome is Outcome.UNSUPPORTED:  # the estimate does not know axioms
        left_s = deadline - time.monotonic()
        answer = _downward(text, [], ["--search", "astar(blind())"], process, left_s)
    return answer


def _downward(
    text: PddlText,
    options: Sequence[str],
    search: Sequence[str],
    process: ProcessHandle,
    limit_s: float,
) -> EngineAnswer:
    with TemporaryDirectory(prefix="rosa-pddl-") as folder:
        files = Path(folder)
        (files / "domain.pddl").write_text(text.domain)
        (files / "problem.pddl").write_text(text.problem)
        command = [*fast_downward_command(), "--plan-file", "plan", *options]
        command += ["domain.pddl", "problem.pddl", *search]
        ended = process.run(command, limit_s=limit_s, folder=folder)
        plan = files / "plan"
        lines = plan.read_text().splitlines() if plan.exists() else []
    if ended.code in (0, 1, 2, 3):
        if b"Plan length:" not in ended.output:
            message = f"the search promised a plan but showed none: {ended.last_words}"
            raise PlanningFailed(Outcome.ENGINE_CRASHED, message)
        words = [line.strip("()").split() for line in lines if line.startswith("(")]
        steps = [EngineStep(each[0], tuple(each[1:])) for each in words]
        outcome = Outcome.SOLVED if options else Outcome.SOLVED_OPTIMALLY
        return EngineAnswer(outcome, tuple(steps))
    outcome = _EXIT_CODES.get(ended.code, Outcome.ENGINE_CRASHED)
    if not outcome.is_trouble or outcome is Outcome.UNSUPPORTED:
        return EngineAnswer(outcome, (), ended.last_words)
    message = f"it ended with exit code {ended.code}; {_INSTALL}. It said: {ended.last_words}"
    raise PlanningFailed(outcome, message)


# ---------------------------------------------------------------- Kairos


class KairosWorker:
    """A process that keeps Kairos and the domains it has read; one question at a time.

    A crash is an outcome, and the next question starts the process anew: Kairos has been seen to
    end its process with a segmentation fault.
    """

    def __init__(self, memory_mb: int) -> None:
        self._memory_mb = memory_mb
        self._process: subprocess.Popen[bytes] | None = None
        self._sent: list[str] = []
        self._lock = Lock()
        self._buffer = b""

    def start(self) -> None:
        """Start the process, unless it runs already."""
        if self._process is None or self._process.poll() is not None:
            self.close()
            command = [sys.executable, "-P", "-c", "from rosa_pddl.engines import serve; serve()"]
            self._process = _start(command, subprocess.PIPE, subprocess.PIPE, subprocess.DEVNULL)
            self._sent = []
            self._buffer = b""
            _WORKERS.add(self)

    def ask(
        self, text: PddlText, process: ProcessHandle, limit_s: float, *, anytime: bool
    ) -> EngineAnswer:
        """Ask for a plan; raises Cancelled, or PlanningFailed if the process ends."""
        deadline = time.monotonic() + limit_s
        while not self._lock.acquire(timeout=_LOOKS_S):
            process.check()
            if time.monotonic() > deadline:
                raise PlanningFailed(Outcome.OUT_OF_TIME, "it was busy with another question")
        process.is_running = True
        try:
            self.start()
            return self._answer(text, process, deadline, anytime)
        finally:
            process.is_running = False
            self._lock.release()

    def _answer(
        self, text: PddlText, process: ProcessHandle, deadline: float, anytime: bool
    ) -> EngineAnswer:
        limit_s = max(deadline - time.monotonic(), 0.01)
        question = {"problem": text.problem, "timeout": limit_s, "anytime": anytime}
        question["memory_mb"] = self._memory_mb
        if text.domain not in self._sent:
            self._sent = [*self._sent[1 - _MOST_DOMAINS :], text.domain]
            question["new"] = text.domain
        question["key"] = str(hash(text.domain))
        self._send(json.dumps(question))
        line = self._read(process, deadline + _GRACE_S / 2)
        answer = json.loads(line)
        outcome = _OUTCOMES.get(answer["status"], Outcome.ENGINE_CRASHED)
        steps = [EngineStep(name, tuple(args), *times) for name, args, *times in answer["plan"]]
        message = answer["message"]
        if outcome is Outcome.SOLVED and answer["stop"] in ("PROVEN_OPTIMAL",):
            outcome = Outcome.SOLVED_OPTIMALLY
        if outcome is Outcome.UNSUPPORTED or outcome is Outcome.ENGINE_CRASHED:
            raise PlanningFailed(outcome, message or answer["status"].lower())
        return EngineAnswer(outcome, tuple(steps), message)

    def _send(self, line: str) -> None:
        assert self._process is not None
        assert self._process.stdin is not None
        try:
            self._process.stdin.write(line.encode() + b"\n")
            self._process.stdin.flush()
        except OSError as error:
            self.close()
            raise PlanningFailed(Outcome.ENGINE_CRASHED, f"its process ended ({error})") from error

    def _read(self, process: ProcessHandle, deadline: float) -> bytes:
        assert self._process is not None
        assert self._process.stdout is not None
        descriptor = self._process.stdout.fileno()
        is_stopped = False
        while b"\n" not in self._buffer:
            if process.is_cancelled and not is_stopped:
                self._send("stop")
                is_stopped = True
                deadline = min(deadline, time.monotonic() + _GRACE_S / 4)
            left_s = deadline - time.monotonic()
            if left_s <= 0.0:
                self.close()
                process.check()
                raise PlanningFailed(Outcome.OUT_OF_TIME, "no answer in time; allow more time")
            if select.select([descriptor], [], [], min(left_s, _LOOKS_S))[0]:
                read = os.read(descriptor, 1 << 16)
                if not read:
                    code = self._process.wait()
                    self.close()
                    message = f"its process ended with code {code}; it is started anew next time"
                    raise PlanningFailed(Outcome.ENGINE_CRASHED, message)
                self._buffer += read
        line, _, self._buffer = self._buffer.partition(b"\n")
        process.check()
        return line

    def __del__(self) -> None:
        self.close()

    def close(self) -> None:
        """End the process."""
        process, self._process = self._process, None
        if process is not None:
            with suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL)
            process.wait()
            for pipe in (process.stdin, process.stdout):
                if pipe is not None:
                    with suppress(OSError):
                        pipe.close()


_WORKERS: WeakSet[KairosWorker] = WeakSet()


@atexit.register
def _close_all() -> None:
    for worker in tuple(_WORKERS):
        worker.close()


@contextmanager
def _answers() -> Iterator[IO[str]]:
    """Yield where answers go; what engines print goes to standard error instead."""
    answers = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)
    yield answers
    answers.flush()


def serve() -> None:
    """Answer questions with Kairos until the input ends; runs in the worker's process."""
    import kairos

    domains: dict[str, Any] = {}
    with _answers() as answers:
        while line := sys.stdin.readline():
            if line.strip() == "stop":  # it came after the answer
                continue
            try:
                answer = _solve_with_kairos(kairos, domains, json.loads(line))
            except kairos.PddlError as error:
                message = str(error).splitlines()[0]
                answer = {"status": "UNSUPPORTED", "stop": "", "plan": [], "message": message}
            answers.write(json.dumps(answer) + "\n")
            answers.flush()
    os.kill(os.getpid(), signal.SIGKILL)


def _solve_with_kairos(
    kairos: Any,  # noqa: ANN401  # the module, which only the worker has imported
    domains: dict[str, Any],
    question: Mapping[str, Any],
) -> dict[str, Any]:
    key = question["key"]
    if "new" in question:
        domains[key] = kairos.parse_domain(question["new"])
        if len(domains) > 2 * _MOST_DOMAINS:
            domains.pop(next(iter(domains)))
    problem = kairos.parse_problem(question["problem"], domains[key])
    search = kairos.Planner().start(
        problem,
        timeout=question["timeout"],
        anytime=question["anytime"],
        memory_limit_mb=question["memory_mb"],
        threads=1,
    )
    while search.running():
        if select.select([sys.stdin], [], [], _POLL_S)[0]:
            search.stop()
            break
    result = search.wait()
    plan = [] if result.plan is None else result.plan.steps
    steps = [[step.name, list(step.args), step.time, step.duration or 0.0] for step in plan]
    status = result.status.name
    if steps or (result.plan is not None and status == "TIMEOUT"):
        status = "SOLVED"
    message = " / ".join(str(each) for each in result.diagnostics)[-400:]
    stop = result.stop_reason.name
    return {"status": status, "stop": stop, "plan": steps, "message": message}


# ---------------------------------------------------------------- engines of unified-planning


def solve_with_engine(
    engine: str, text: PddlText, process: ProcessHandle, limit_s: float
) -> EngineAnswer:
    """Ask an engine of unified-planning, by its name."""
    given = json.dumps({"engine": engine, "domain": text.domain, "problem": text.problem})
    command = [sys.executable, "-P", "-c", "from rosa_pddl.engines import solve; solve()"]
    ended = process.run(command, given=given.encode(), limit_s=limit_s)
    try:
        answer = json.loads(ended.output)
        steps = [EngineStep(name, tuple(args), *times) for name, args, *times in answer["plan"]]
    except (ValueError, KeyError, TypeError) as error:
        message = f"it ended with exit code {ended.code} and no answer. It said: {ended.last_words}"
        raise PlanningFailed(Outcome.ENGINE_CRASHED, message) from error
    outcome = _OUTCOMES.get(answer["status"], Outcome.ENGINE_CRASHED)
    if outcome.is_trouble:
        raise PlanningFailed(outcome, answer["message"] or "it said nothing")
    return EngineAnswer(outcome, tuple(steps), answer["message"])


def solve() -> None:
    """Solve one problem from standard input with an engine; runs in a process of its own."""
    with _answers() as answers:
        try:
            answer = _solve_with_unified_planning(**json.load(sys.stdin))
        except MemoryError:
            answer = {"status": "MEMOUT", "plan": [], "message": "it ran out of memory"}
        except Exception as error:  # an engine may raise anything; its text is the answer
            message = f"{type(error).__name__}: {error}"[-400:]
            answer = {"status": "INTERNAL_ERROR", "plan": [], "message": message}
        json.dump(answer, answers)
    # engines may leave threads running that would prevent this process from ending
    os.kill(os.getpid(), signal.SIGKILL)


def _solve_with_unified_planning(engine: str, domain: str, problem: str) -> dict[str, Any]:
    read = up_problem_of(PddlText(domain, problem, {}))
    environment = read.environment
    environment.credits_stream = None
    solver = environment.factory.engine(engine)()
    missing = read.kind.features - solver.supported_kind().features
    if missing:
        message = f"it does not support {', '.join(sorted(missing)).lower()}"
        return {"status": "UNSUPPORTED_PROBLEM", "plan": [], "message": message}
    answer = solver.solve(read)
    message = " / ".join(log.message for log in answer.log_messages or ())[-400:]
    steps = list(_steps_of(answer.plan))
    return {"status": answer.status.name, "plan": steps, "message": message}


def up_problem_of(text: PddlText) -> Any:  # noqa: ANN401  # a problem of unified-planning
    """Read a problem with unified-planning's reader."""
    from unified_planning.io import PDDLReader

    return PDDLReader().parse_problem_string(_distinct(text.domain), _distinct(text.problem))


def _distinct(text: str) -> str:
    """Give types names of their own, as unified-planning wants names of all kinds to differ."""
    renamed = re.sub(r"(?<= - )(?!object\b)[A-Za-z][\w.:-]*", lambda m: f"{m[0]}-type", text)
    return re.sub(r"\(:types ([^)]*)\)", _distinct_types, renamed)


def _distinct_types(match: re.Match[str]) -> str:
    words = match[1].split()
    names = [f"{word}-type" if n % 3 == 0 else word for n, word in enumerate(words)]
    return f"(:types {' '.join(names)})"


def _steps_of(plan: Any) -> Iterator[list[Any]]:  # noqa: ANN401  # a plan of unified-planning
    if plan is None:
        return
    if hasattr(plan, "timed_actions"):
        for start, action, duration in sorted(plan.timed_actions, key=lambda timed: timed[0]):
            yield [*_name_of(action), float(start), float(duration or 0)]
    else:
        for action in plan.actions:
            yield _name_of(action)


def _name_of(action: Any) -> list[Any]:  # noqa: ANN401  # an action of unified-planning
    arguments = [argument.object().name for argument in action.actual_parameters]
    return [action.action.name, arguments]


def check_name(engine: str) -> str | None:
    """Return what is wrong with the name of an engine, else None."""
    if engine in (*DOWNWARD, KAIROS):
        return None
    from unified_planning.engines.factory import DEFAULT_ENGINES

    if engine in DEFAULT_ENGINES:
        return None
    names = [*DOWNWARD, KAIROS, *DEFAULT_ENGINES]
    return f"there is no planning engine {engine!r}; {nearest(engine, names)}"


def missing_package(engine: str) -> str | None:
    """Return what to install if an engine is missing, else None."""
    if engine in DOWNWARD:
        is_there, package = bool(fast_downward_command()), "up-fast-downward"
    elif engine == KAIROS:
        is_there, package = find_spec("kairos") is not None, "kairos-planner"
    else:
        from unified_planning.engines.factory import DEFAULT_ENGINES

        module = DEFAULT_ENGINES[engine][0].split(".")[0]
        package = module.replace("_", "-")
        is_there = module == "unified_planning" or find_spec(module) is not None
    if is_there:
        return None
    return f"the planning engine {engine!r} is not installed; try 'pip install {package}'"


