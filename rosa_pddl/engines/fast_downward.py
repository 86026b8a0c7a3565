"""Runs Fast Downward's search as a separate program.

It is licensed under the GPL-3, so nothing of it is imported here. Its documentation, "translator output format" and
"exit codes", describes the formats and exit codes.
"""

import re
from functools import cache
from importlib.util import find_spec
from pathlib import Path

from rosa_pddl.engines.processes import INSTALL_ADVICE, ProcessHandle
from rosa_pddl.outcomes import Outcome, Trouble

SEARCHES = ("fast-downward-opt", "fast-downward")
"""The engines that use this program: for an optimal plan, and for any plan."""

_STEP = re.compile(rb"^(\d+) \(\d+\)$", re.MULTILINE)
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


def search(text: str, strategy: str, process: ProcessHandle, *, limit_s: float) -> tuple[int, ...] | Outcome:
    """Search for a plan within `limit_s` of wall-clock time [s]; raises Trouble or Cancelled.

    Returns the names of the plan's operators, which must be numbers, or an outcome if there is no plan.
    """
    command = [str(program()), "--search", strategy, "--internal-plan-file", "/dev/null"]
    ended = process.ask(command, given=text.encode(), limit_s=limit_s)
    if ended.code in (0, 1, 2, 3):
        if b"Plan length:" not in ended.output:
            raise Trouble(Outcome.ENGINE_CRASHED, f"the search promised a plan but showed none: {ended.last_words}")
        return tuple(int(number) for number in _STEP.findall(ended.output))
    outcome = _OUTCOMES.get(ended.code, Outcome.ENGINE_CRASHED)
    if not outcome.is_trouble:
        return outcome
    raise Trouble(outcome, f"it ended with exit code {ended.code}; {INSTALL_ADVICE}. It said: {ended.last_words}")


@cache
def program() -> Path | None:
    """Return the path of the search program; None if it is not installed."""
    found = find_spec("up_fast_downward")
    if found is None or found.origin is None:
        return None
    path = Path(found.origin).parent / "downward" / "builds" / "release" / "bin" / "downward"
    return path if path.exists() else None
