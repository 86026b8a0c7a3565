"""Runs an engine of unified-planning in a process of its own: reads a pickled problem and writes the answer as JSON.

It is started as a program and imports nothing from this package.
"""

import json
import os
import pickle
import signal
import sys
from types import ModuleType
from typing import Any


def main() -> None:
    answers = os.fdopen(os.dup(1), "w", encoding="utf-8")
    # engines' own output goes to standard error, so that it does not mix with the answer
    os.dup2(2, 1)
    # unified-planning needs ConfigSpace for a type name only, but importing it takes seconds (scipy.stats)
    sys.modules["ConfigSpace"] = _Unneeded("ConfigSpace")
    try:
        answer = _solved(**pickle.load(sys.stdin.buffer))
    except MemoryError:
        answer = {"status": "MEMOUT"}
    except Exception as error:  # an engine may raise anything; its name and text are the answer
        answer = {"status": "INTERNAL_ERROR", "said": f"{type(error).__name__}: {error}"}
    json.dump(answer, answers)
    answers.close()
    # engines may leave threads running that would prevent this process from ending
    os.kill(os.getpid(), signal.SIGKILL)


class _Unneeded(ModuleType):
    ConfigurationSpace = object


def _solved(engine: str, problem: Any) -> dict[str, Any]:  # noqa: ANN401  # unified-planning ships no types
    import unified_planning.environment as module

    del sys.modules["ConfigSpace"]
    # some engines use the global environment, whichever they are given
    module.GLOBAL_ENVIRONMENT = problem.environment
    problem.environment.credits_stream = None
    made = problem.environment.factory.engine(engine)()
    made.skip_checks = True
    answer = made.solve(problem)
    logs = "\n".join(log.message for log in answer.log_messages or ())
    return {"status": answer.status.name, "plan": _written(answer.plan), "said": logs[-1000:]}


def _written(plan: Any) -> list[Any] | None:  # noqa: ANN401  # unified-planning ships no types
    if plan is None:
        return None
    if hasattr(plan, "timed_actions"):
        return [
            [*_named(one), float(start), float(duration or 0)]
            for start, one, duration in sorted(plan.timed_actions, key=lambda timed: timed[0])
        ]
    return [_named(one) for one in plan.actions]


def _named(one: Any) -> list[Any]:  # noqa: ANN401  # unified-planning ships no types
    return [one.action.name, [argument.object().name for argument in one.actual_parameters]]


if __name__ == "__main__":
    main()
