"""Checks whether an environment keeps the promises that task layers and managers rely on."""

import math
from collections.abc import Callable
from dataclasses import asdict

from suave_env.env import SuaveEnv
from suave_env.monitors import Message, Status
from suave_env.settings import SuaveEnvError

SPAN_S = 12.0
"""Length of each trial [s]: enough for the monitors, which publish every second, and for a search to begin."""

_SLICES = (0.01, 0.37, 0.38, 1.0, 3.333, 7.5, SPAN_S)


class BrokenEnvError(SuaveEnvError):
    """An environment breaks a promise; the message says which, and what was seen."""


def check_env(make: Callable[[int], SuaveEnv], component: str = "spiral_search") -> None:
    """Check whether an environment keeps its promises; each trial opens a new one.

    Time advances exactly as requested and never back; messages lie within the requested time, in order, and are plain
    data; nobody can change the environment through what it returns; the same seed gives the same run, another seed a
    different one, and slices of time change nothing; components obey, and unknown names are refused; observations are
    finite.

    Args:
        make: Opens the environment with a seed.
        component: A component that it manages.

    Raises:
        BrokenEnvError: The first promise that is broken.
    """
    _check_time(make(0))
    _check_course(make(0), component)
    whole, sliced = _run(make(0), component, (SPAN_S,)), _run(make(0), component, _SLICES)
    again = _run(make(0), component, (SPAN_S,))
    _require(
        whole == again,
        "the same seed gives the same run; it did not: chance comes from elsewhere too",
    )
    another = _run(make(1), component, (SPAN_S,))
    _require(
        whole != another, "another seed gives another run; it did not: the generator is not used"
    )
    _require(
        whole == sliced,
        f"how time is sliced changes nothing; advancing by {_SLICES} was another run",
    )
    touched = _run(make(0), component, _SLICES, is_touched=True)
    _require(
        sliced == touched, "what is done with what was returned changes nothing; it changed the run"
    )
    _check_components(make(0), component)


def _require(holds: bool, text: str) -> None:
    if not holds:
        raise BrokenEnvError(text)


def _refuses(act: Callable[..., object], *given: object) -> bool:
    try:
        act(*given)
    except SuaveEnvError:
        return True
    return False


def _check_time(env: SuaveEnv) -> None:
    _require(env.now == 0, f"time begins at 0 s, not at {env.now!r}")
    for until in (0.3, 0.31, 2.0):
        env.advance(until)
        _require(env.now == until, f"advance({until}) ends at {until} s, not at {env.now!r}")
    for until in (1.0, math.nan, math.inf):
        text = f"advance({until}) at {env.now} s raises SuaveEnvError: time goes on, and to a finite time"
        _require(_refuses(env.advance, until), text)


def _check_course(env: SuaveEnv, component: str) -> None:
    """Check messages and observations while a component is active."""
    env.components.activate(component)
    before, heard = 0.0, 0
    for step in range(1, round(2 * SPAN_S) + 1):
        for message in env.advance(step / 2):
            _check_message(message, before, step / 2)
            before, heard = message["time"], heard + 1
        seen = env.observe()
        for name, value in asdict(seen).items():
            finite = not isinstance(value, float) or math.isfinite(value)
            _require(finite, f"what is observed is finite; {name} is {value!r} at {env.now} s")
        _require(seen.time == env.now, f"the time observed is now, {env.now} s, not {seen.time!r}")
        _require(
            0 <= seen.battery_level <= 1,
            f"a battery level is from 0 to 1, not {seen.battery_level!r}",
        )
    _require(heard > 0, f"monitors publish; nothing was heard in {SPAN_S:g} s")


def _check_message(message: Message, before: float, until: float) -> None:
    _require(
        set(message) == {"time", "status"},
        f"a message has a time and a status, not {sorted(message)}",
    )
    came = f"{message['time']!r} came after {before} and by {until} s"
    is_due = before <= message["time"] <= until
    _require(is_due, f"messages come in order of time and within the time asked for; {came}")
    for status in message["status"]:
        _require(
            set(status) == {"name", "message", "values"},
            f"a status has name, message, values: {sorted(status)}",
        )
        words = [status["name"], status["message"], *status["values"], *status["values"].values()]
        _require(
            all(isinstance(word, str) for word in words),
            f"a status holds strings only, not {status!r}",
        )


def _run(
    env: SuaveEnv, component: str, times: tuple[float, ...], is_touched: bool = False
) -> tuple[object, ...]:
    """Return messages, disturbances and the last observation; if touched, destroy what the environment returns."""
    env.components.activate(component)
    published = list[tuple[float, list[Status]]]()
    for time in times:
        heard = env.advance(time)
        published += [(one["time"], list(one["status"])) for one in heard]
        if is_touched:
            for message in heard:
                message["status"].clear()
            heard.clear()
            env.disturbances.clear()
    return published, env.disturbances, env.observe()


def _check_components(env: SuaveEnv, component: str) -> None:
    components = env.components
    for act in (
        components.activate,
        components.deactivate,
        components.is_active,
        components.parameters,
    ):
        _require(
            _refuses(act, "no such component"), "an unknown component is refused: SuaveEnvError"
        )
    for change, is_active in ((components.deactivate, False), (components.activate, True)):
        change(component)
        word = "active" if is_active else "inactive"
        _require(
            components.is_active(component) is is_active,
            f"{component} is {word} when it was asked to be",
        )
        _require(
            (component in env.observe().active) is is_active,
            f"{component} is observed to be {word}",
        )
