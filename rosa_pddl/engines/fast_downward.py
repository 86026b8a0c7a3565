"""Fast Downward's search as a program of its own.

It is licensed under the GPL-3: nothing of it is imported here. Formats and exit codes are those of its documentation,
"translator output format" and "exit codes".
"""

import re
from functools import cache
from importlib.util import find_spec
from pathlib import Path

from rosa_pddl.engines.processes import INSTALL_ADVICE, ProcessHandle
from rosa_pddl.outcomes import Outcome, Trouble

SEARCHES = ("fast-downward-opt", "fast-downward")
"""The engines that this program stands for: the best plan, and a plan."""

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
    """Search a plan in so much wall-clock time [s]; raises Trouble, or Cancelled.

    Returns the names of its operators, which have to be numbers, or that it is unsolvable.
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
    """Return the file of the search; None if it is not installed."""
    found = find_spec("up_fast_downward")
    if found is None or found.origin is None:
        return None
    path = Path(found.origin).parent / "downward" / "builds" / "release" / "bin" / "downward"
    return path if path.exists() else None
