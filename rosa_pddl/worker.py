"""Solves planning problems in a process of its own, for `engines`; it runs as a program.

Each line of input is a question in JSON, each line of output its answer. Nothing of Fast Downward
is imported, as it is licensed under the GPL-3. Kairos has been seen to end its process with a
segmentation fault.
"""

import json
import os
import re
import signal
import subprocess
import sys
from collections.abc import Iterator, Mapping
from functools import lru_cache
from importlib.util import find_spec
from pathlib import Path
from typing import Any

Answer = dict[str, Any]

_DOWNWARD = {
    "fast-downward": ([["--alias", "lama-first"], []], "solved"),
    "fast-downward-opt": ([[], ["--search", "astar(lmcut())"]], "solved optimally"),
    # the estimate does not know derived predicates
    "axioms": ([[], ["--search", "astar(blind())"]], "solved optimally"),
}
_EXIT_CODES = {
    10: "unsolvable proven",
    11: "unsolvable proven",
    12: "unsolvable as far as known",
    20: "out of memory",
    21: "out of time",
    22: "out of memory",
    23: "out of time",
    34: "unsupported",
}
# What unified-planning and Kairos call their outcomes.
_OUTCOMES = {
    "SOLVED_SATISFICING": "solved",
    "SOLVED_OPTIMALLY": "solved optimally",
    "UNSOLVABLE_PROVEN": "unsolvable proven",
    "UNSOLVABLE_INCOMPLETELY": "unsolvable as far as known",
    "MEMOUT": "out of memory",
    "UNSUPPORTED_PROBLEM": "unsupported",
    "SOLVED": "solved",
    "UNSOLVABLE": "unsolvable proven",
    "NO_PLAN_FOUND": "unsolvable as far as known",
    "TIMEOUT": "out of time",
    "OUT_OF_MEMORY": "out of memory",
    "GROUNDING_TOO_LARGE": "out of memory",
    "UNSUPPORTED": "unsupported",
    "INVALID_INPUT": "unsupported",
}


def answer_of(outcome: str, message: str = "", plan: Any = ()) -> Answer:  # noqa: ANN401  # what JSON holds
    """Return an answer: the name of the outcome, a message, and the steps of the plan."""
    return {"outcome": outcome, "message": message[-400:], "plan": list(plan)}


# ---------------------------------------------------------------- Fast Downward


def fast_downward_command() -> tuple[str, ...]:
    """Return how Fast Downward is started; empty if it is not installed."""
    package = find_spec("up_fast_downward")
    if package is None or package.origin is None:
        return ()
    path = Path(package.origin).parent / "downward" / "fast-downward.py"
    return (sys.executable, str(path)) if path.exists() else ()


def downward(engine: str, question: Mapping[str, Any]) -> Answer:
    """Search with Fast Downward, as unified-planning's engine of the same name does.

    Its files are in the current folder, which is this process's own.
    """
    (options, search), solved = _DOWNWARD[engine]
    Path("domain.pddl").write_text(question["domain"])
    Path("problem.pddl").write_text(question["problem"])
    plan = Path("plan")
    plan.unlink(missing_ok=True)  # of the question before
    limit = ["--overall-time-limit", f"{int(question['limit_s']) + 2}s", "--plan-file", "plan"]
    files = ["domain.pddl", "problem.pddl"]
    ended = subprocess.run(
        [*fast_downward_command(), *limit, *options, *files, *search],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        check=False,
    )
    if ended.returncode in (0, 1, 2, 3) and plan.exists():
        lines = plan.read_text().splitlines()
        words = [line.strip("()").split() for line in lines if line.startswith("(")]
        return answer_of(solved, plan=[[each[0], each[1:]] for each in words])
    outcome = _EXIT_CODES.get(ended.returncode, "engine crashed")
    if outcome == "unsupported" and engine == "fast-downward-opt":
        return downward("axioms", question)
    if outcome.startswith("unsolvable"):
        return answer_of(outcome)
    said = " / ".join(ended.stdout[-2000:].decode(errors="replace").split("\n")[-4:])
    advice = "try 'pip install --force-reinstall up-fast-downward'"
    return answer_of(outcome, f"it ended with exit code {ended.returncode}; {advice}. {said}")


# ---------------------------------------------------------------- Kairos


@lru_cache(8)
def _kairos_domain(text: str) -> Any:  # noqa: ANN401  # a domain of Kairos
    import kairos

    return kairos.parse_domain(text)


def with_kairos(question: Mapping[str, Any]) -> Answer:
    """Plan with Kairos, which keeps the domains that it has read."""
    import kairos

    try:
        domain = _kairos_domain(question["domain"])
        problem = kairos.parse_problem(question["problem"], domain)
    except kairos.PddlError as error:
        return answer_of("unsupported", str(error).splitlines()[0])
    limits = {"timeout": question["limit_s"], "memory_limit_mb": question["memory_mb"]}
    result = kairos.solve(domain, problem, anytime=True, threads=1, **limits)
    message = " / ".join(str(each) for each in result.diagnostics)
    if result.plan is None:
        status = result.status.name
        return answer_of(_OUTCOMES.get(status, "engine crashed"), message or status.lower())
    steps = list[Any]()
    for step in result.plan.steps:
        steps.append([step.name, list(step.args), step.time, step.duration or 0.0])
    is_proven = result.stop_reason.name == "PROVEN_OPTIMAL"
    return answer_of("solved optimally" if is_proven else "solved", plan=steps)


# ---------------------------------------------------------------- engines of unified-planning


def with_unified_planning(engine: str, question: Mapping[str, Any]) -> Answer:
    """Plan with an engine of unified-planning, by its name."""
    problem = up_problem_of(question["domain"], question["problem"])
    environment = problem.environment
    environment.credits_stream = None
    solver = environment.factory.engine(engine)()
    missing = problem.kind.features - solver.supported_kind().features
    if missing:
        names = ", ".join(sorted(missing)).lower()
        return answer_of("unsupported", f"it does not support {names}")
    result = solver.solve(problem)
    message = " / ".join(log.message for log in result.log_messages or ())
    outcome = _OUTCOMES.get(result.status.name, "engine crashed")
    return answer_of(outcome, message, _steps_of(result.plan))


def up_problem_of(domain: str, problem: str) -> Any:  # noqa: ANN401  # of unified-planning
    """Read a problem with unified-planning's reader, which wants types with names of their own."""
    from unified_planning.io import PDDLReader

    pattern = r"(?<= - )(?!object\b)[A-Za-z][\w.:-]*|(?<=\(:types )[^)]*"
    texts = [re.sub(pattern, _distinct, text) for text in (domain, problem)]
    return PDDLReader().parse_problem_string(*texts)


def _distinct(match: re.Match[str]) -> str:
    names = [word if word in ("-", "object") else f"{word}-type" for word in match[0].split()]
    return " ".join(names)


def _steps_of(plan: Any) -> Iterator[list[Any]]:  # noqa: ANN401  # a plan of unified-planning
    if hasattr(plan, "timed_actions"):
        for start, action, duration in sorted(plan.timed_actions, key=lambda timed: timed[0]):
            yield [*_name_of(action), float(start), float(duration or 0)]
    elif plan is not None:
        for action in plan.actions:
            yield _name_of(action)


def _name_of(action: Any) -> list[Any]:  # noqa: ANN401  # an action of unified-planning
    arguments = [argument.object().name for argument in action.actual_parameters]
    return [action.action.name, arguments]


def solve(question: Mapping[str, Any]) -> Answer:
    """Answer a question; an error in an engine is an answer, too."""
    engine = question["engine"]
    try:
        if engine in _DOWNWARD:
            return downward(engine, question)
        if engine == "kairos":
            return with_kairos(question)
        return with_unified_planning(engine, question)
    except MemoryError:
        return answer_of("out of memory")
    except Exception as error:  # an engine may raise anything; its text is the answer
        return answer_of("engine crashed", f"{type(error).__name__}: {error}")


if __name__ == "__main__":
    with os.fdopen(os.dup(1), "w", encoding="utf-8") as output:
        os.dup2(2, 1)  # what engines print does not disturb the answers
        for line in sys.stdin:
            print(json.dumps(solve(json.loads(line))), file=output, flush=True)
    os.kill(os.getpid(), signal.SIGKILL)  # engines may leave threads running
