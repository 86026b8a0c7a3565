"""A judge of environments: whether one keeps the promises that tasks and managers rely on."""

import math
from collections.abc import Callable
from dataclasses import fields

from suave_env.env import Observation, SuaveEnv
from suave_env.monitors import Message
from suave_env.settings import SuaveEnvError

SPAN_S = 12.0
"""How long each trial of an environment is [s]: monitors publish every second, and the search has begun."""


class BrokenEnvError(SuaveEnvError):
    """An environment breaks a promise; the message says which, and what was seen."""


def check_env(make: Callable[[int], SuaveEnv], component: str = "spiral_search") -> None:
    """Try whether an environment keeps its promises; each trial opens it anew.

    Time goes on exactly as asked for and never back; what is published lies within the time asked for, in order, and is
    plain data; nobody can change the environment through what it returned; the same seed gives the same run, another
    one another, and how time is sliced changes nothing; components obey, unknown ones are refused by name; what is
    observed is finite; a closed environment stands still.

    Args:
        make: Opens the environment with a seed.
        component: A component that it manages and that is inactive at first.

    Raises:
        BrokenEnvError: The first promise that is broken.
    """
    _check_time(make(0))
    _check_messages(make(0))
    _check_observation(make(0), component)
    _check_memory(make)
    _check_chance(make, component)
    _check_slices(make, component)
    _check_components(make(0), component)
    _check_end(make(0), component)


def _require(holds: bool, text: str) -> None:
    if not holds:
        raise BrokenEnvError(text)


def _refuses(act: Callable[[], object]) -> bool:
    try:
        act()
    except SuaveEnvError:
        return True
    return False


def _check_time(env: SuaveEnv) -> None:
    _require(env.now == 0, f"time begins at 0 s, not at {env.now!r}")
    for until in (0.3, 0.31, 2.0):
        env.advance(until)
        _require(env.now == until, f"advance({until}) ends at {until} s, not at {env.now!r}")
    for until in (1.0, math.nan, math.inf):
        _require(
            _refuses(lambda until=until: env.advance(until)),  # type: ignore[misc]  # the lambda is called at once
            f"advance({until}) at {env.now} s raises SuaveEnvError: time goes on, and to a finite time",
        )


def _check_messages(env: SuaveEnv) -> None:
    before, heard = 0.0, 0
    for step in range(1, round(SPAN_S / 0.5) + 1):
        until = 0.5 * step
        for message in env.advance(until):
            _check_message(message, before, until)
            before, heard = message["time"], heard + 1
    _require(heard > 0, f"monitors publish; nothing was heard in {SPAN_S:g} s")


def _check_message(message: Message, before: float, until: float) -> None:
    _require(set(message) == {"time", "status"}, f"a message has a time and a status, not {sorted(message)}")
    time = message["time"]
    _require(
        isinstance(time, float) and before <= time <= until,
        f"messages come in order of time and within the time asked for; {time!r} came after {before} and by {until} s",
    )
    for status in message["status"]:
        _require(set(status) == {"name", "message", "values"}, f"a status has name, message, values: {sorted(status)}")
        words = [status["name"], status["message"], *status["values"], *status["values"].values()]
        _require(all(isinstance(word, str) for word in words), f"a status holds strings only, not {status!r}")


def _check_observation(env: SuaveEnv, component: str) -> None:
    env.components.activate(component)
    for until in range(1, round(SPAN_S)):
        env.advance(float(until))
        seen = env.observe()
        for field in fields(Observation):
            value = getattr(seen, field.name)
            finite = not isinstance(value, float) or math.isfinite(value)
            _require(finite, f"what is observed is finite; {field.name} is {value!r} at {until} s")
        _require(seen.time == env.now, f"the time observed is now, {env.now} s, not {seen.time!r}")
        _require(0 <= seen.battery_level <= 1, f"a battery level is from 0 to 1, not {seen.battery_level!r}")


def _check_memory(make: Callable[[int], SuaveEnv]) -> None:
    touched, twin = make(0), make(0)
    for until in (5.0, SPAN_S):
        heard, expected = touched.advance(until), twin.advance(until)
        same = heard == expected
        _require(same, f"what is done with the messages that were returned changes later ones, before {until:g} s")
        for message in heard:
            message["status"].clear()
        heard.clear()
        touched.disturbances.clear()
    same = touched.disturbances == twin.disturbances
    _require(same, "what is done with the disturbances that were returned changes the environment")


def _check_chance(make: Callable[[int], SuaveEnv], component: str) -> None:
    runs = [_run(make(seed), component, (SPAN_S,)) for seed in (0, 0, 1)]
    _require(runs[0] == runs[1], "the same seed gives the same run; it did not: chance comes from elsewhere too")
    _require(runs[0] != runs[2], "another seed gives another run; it did not: the generator is not used")


def _check_slices(make: Callable[[int], SuaveEnv], component: str) -> None:
    slices = (0.01, 0.37, 0.38, 1.0, 3.333, 7.5, SPAN_S)
    whole, sliced = _run(make(0), component, (SPAN_S,)), _run(make(0), component, slices)
    _require(whole == sliced, f"how time is sliced changes nothing; advancing by {slices} was another run")


def _run(env: SuaveEnv, component: str, times: tuple[float, ...]) -> tuple[list[Message], Observation]:
    env.components.activate(component)
    return [message for time in times for message in env.advance(time)], env.observe()


def _check_components(env: SuaveEnv, component: str) -> None:
    components = env.components
    for act in (components.activate, components.deactivate, components.is_active, components.parameters):
        _require(_refuses(lambda act=act: act("no such component")), "an unknown component is refused: SuaveEnvError")  # type: ignore[misc]  # called at once
    _require(component in components.names, f"{component} is among the components, {', '.join(components.names)}")
    _require(not components.is_active(component), f"{component} is inactive at first")
    for wanted, change in ((True, components.activate), (False, components.deactivate)):
        change(component)
        word = "active" if wanted else "inactive"
        _require(components.is_active(component) is wanted, f"{component} is {word} when it was asked to be")
        _require((component in env.observe().active) is wanted, f"{component} is observed to be {word}")
        env.advance(env.now + 5)


def _check_end(env: SuaveEnv, component: str) -> None:
    env.advance(1.0)
    env.close()
    env.close()
    _require(_refuses(lambda: env.advance(2.0)), "a closed environment refuses to advance: SuaveEnvError")
    _require(_refuses(lambda: env.components.activate(component)), "a closed environment refuses changes")
    _require(env.now == 1.0, f"a closed environment stands still at 1 s, not at {env.now!r}")
