"""Fast Downward as two programs of its own: the translator of PDDL, and the search.

It is licensed under the GPL-3: nothing of it is imported here. Its exit codes are those of its documentation,
"exit codes".
"""

import re
import sys
from dataclasses import dataclass
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from tempfile import TemporaryDirectory

from rosa_pddl.planning.grounded import Patched
from rosa_pddl.planning.outcomes import Outcome
from rosa_pddl.planning.processes import Ended, Leash
from rosa_pddl.planning.sas import SasTask, parse

__all__ = ["Answer", "SEARCHES", "Trouble", "install_advice", "missing_part", "search", "translate"]

SEARCHES = ("fast-downward-opt", "fast-downward")
"""The engines that these two programs stand for: the best plan, and a plan."""

# Looking at every state is quicker than estimating while they are this few; beyond, estimates pay.
_FEW_STATES = 1e6
_STEP = re.compile(rb"^(\d+) \(\d+\)$", re.MULTILINE)
_LENGTH = re.compile(rb"Plan length: (\d+) step")
_FITS_ANY_STATE = ("--keep-unreachable-facts", "--keep-unimportant-variables")
_OUTCOMES = {
    10: Outcome.UNSOLVABLE_PROVEN,
    11: Outcome.UNSOLVABLE_PROVEN,
    12: Outcome.UNSOLVABLE_AS_FAR_AS_KNOWN,
    20: Outcome.OUT_OF_MEMORY,
    21: Outcome.OUT_OF_TIME,
    22: Outcome.OUT_OF_MEMORY,
    23: Outcome.OUT_OF_TIME,
    34: Outcome.UNSUPPORTED,
}


class Trouble(Exception):
    """Why there is no answer: an outcome on its way to the planner, which reports it."""

    def __init__(self, outcome: Outcome, message: str) -> None:
        super().__init__(message)
        self.outcome = outcome
        self.message = message


@dataclass(frozen=True)
class Answer:
    """What the search found.

    Args:
        outcome: how it ended.
        numbers: the operators of the plan, in order.
        why: why there is no plan, if more is known than that.
    """

    outcome: Outcome
    numbers: tuple[int, ...] = ()
    why: str = ""


def missing_part() -> str | None:
    """Return which of the two programs is not installed, as a file or module; None if both are there."""
    if _program() is None:
        return "up_fast_downward"
    return None if _translator() is not None else "fast_downward.translate"


def install_advice() -> str:
    """Say what to do when a program does not work."""
    return "try 'pip install --force-reinstall up-fast-downward'"


def translate(
    domain: str, problem: str, leash: Leash, *, limit_s: float, memory_bytes: int | None, for_any_state: bool
) -> SasTask:
    """Translate a task.

    Args:
        domain: PDDL text.
        problem: PDDL text.
        leash: runs the program.
        limit_s: wall-clock time that it may take [s].
        memory_bytes: how much data it may hold [B].
        for_any_state: whether to keep what is of no use from the initial state and for the goal.

    Raises:
        Trouble: there is no translated task.
        Cut: the leash was cut.
    """
    with TemporaryDirectory(prefix="rosa_pddl_") as folder:
        place = Path(folder)
        (place / "domain.pddl").write_text(domain, encoding="utf-8")
        (place / "problem.pddl").write_text(problem, encoding="utf-8")
        options = _FITS_ANY_STATE if for_any_state else ()
        command = [sys.executable, "-m", "fast_downward.translate", *options, "domain.pddl", "problem.pddl"]
        ended = _run(
            leash,
            command,
            limit_s=limit_s,
            memory_bytes=memory_bytes,
            environment={"PYTHONPATH": str(_translator()), "PYTHONDONTWRITEBYTECODE": "1"},
            folder=folder,
        )
        written = place / "output.sas"
        if ended.code != 0 or not written.exists():
            raise _trouble("the translator", ended)
        try:
            return parse(written.read_text(encoding="utf-8"))
        except ValueError as error:
            raise Trouble(Outcome.ENGINE_CRASHED, f"the translator wrote rubbish: {error}") from error


def search(patched: Patched, engine: str, leash: Leash, *, limit_s: float, memory_bytes: int | None) -> Answer:
    """Search a plan.

    Args:
        patched: the task.
        engine: one of `SEARCHES`.
        leash: runs the program.
        limit_s: wall-clock time that it may take [s].
        memory_bytes: how much data it may hold [B].

    Raises:
        Trouble: there is no answer.
        Cut: the leash was cut.
    """
    command = [str(_program()), "--search", _strategy(patched, engine), "--internal-plan-file", "/dev/null"]
    ended = _run(leash, command, given=patched.text, limit_s=limit_s, memory_bytes=memory_bytes)
    if ended.code in (0, 1, 2, 3):
        length = _LENGTH.search(ended.output)
        numbers = tuple(int(number) for number in _STEP.findall(ended.output))
        if length is None or int(length.group(1)) != len(numbers):
            raise Trouble(Outcome.ENGINE_CRASHED, f"the search promised a plan but showed none: {ended.last_words}")
        return Answer(Outcome.SOLVED_OPTIMALLY if engine == "fast-downward-opt" else Outcome.SOLVED, numbers)
    outcome = _OUTCOMES.get(ended.code)
    if outcome is not None and not outcome.is_trouble:
        return Answer(outcome)
    raise _trouble("the search", ended)


def _strategy(patched: Patched, engine: str) -> str:
    # each line that is written wakes this process up
    quiet = "verbosity=silent"
    if engine != "fast-downward-opt":
        return f"lazy_greedy([ff()], preferred=[ff()], {quiet})"
    blind = patched.states <= _FEW_STATES or patched.is_conditional or patched.has_axioms
    return f"astar({'blind' if blind else 'lmcut'}(), {quiet})"


def _run(leash: Leash, command: list[str], **settings: object) -> Ended:
    try:
        ended = leash.run(command, **settings)  # type: ignore[arg-type]  # handed through as they were given
    except OSError as error:
        raise Trouble(Outcome.ENGINE_MISSING, f"it cannot be started ({error}); {install_advice()}") from error
    if ended.is_late:
        raise Trouble(Outcome.OUT_OF_TIME, f"no answer after {settings['limit_s']:.3g} s; allow more time or ask less")
    return ended


def _trouble(who: str, ended: Ended) -> Trouble:
    if ended.is_endless:
        return Trouble(Outcome.ENGINE_CRASHED, f"{who} printed without end: {ended.last_words}")
    outcome = _OUTCOMES.get(ended.code, Outcome.ENGINE_CRASHED)
    if outcome is Outcome.ENGINE_CRASHED:
        how = f"was killed by signal {-ended.code}" if ended.code < 0 else f"ended with exit code {ended.code}"
        return Trouble(outcome, f"{who} {how}; {install_advice()}. It said: {ended.last_words}")
    return Trouble(outcome, f"{who} said: {ended.last_words}")


@cache
def _program() -> Path | None:
    """Return the file of the search."""
    found = find_spec("up_fast_downward")
    if found is None or found.origin is None:
        return None
    path = Path(found.origin).parent / "downward" / "builds" / "release" / "bin" / "downward"
    return path if path.exists() else None


@cache
def _translator() -> Path | None:
    """Return the folder that holds the package of the translator."""
    found = find_spec("fast_downward")
    for place in (found.submodule_search_locations or ()) if found is not None else ():
        if (Path(place) / "translate" / "__main__.py").exists():
            return Path(place).parent
    program = _program()
    if program is not None and (program.parent / "fast_downward" / "translate" / "__main__.py").exists():
        return program.parent
    return None
