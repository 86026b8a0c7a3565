"""The judge of environments, tried on sound and on deliberately broken ones."""

import dataclasses
import math
import random

import numpy as np
import pytest

from suave_env import BrokenEnvError, Settings, SuaveEnv, SuaveEnvError, check_env

SHARED = random.Random(1)


def opened(kind=SuaveEnv, **changes):
    return lambda seed: kind(Settings().replace(**changes), np.random.default_rng(seed))


class RunsAhead(SuaveEnv):
    def advance(self, until, *, pause=False):
        heard = super().advance(until, pause=pause)
        self.now += 0.001
        return heard


class GoesBack(SuaveEnv):
    def advance(self, until, *, pause=False):
        return super().advance(
            max(until, self.now) if math.isfinite(until) else self.now, pause=pause
        )


class TellsLate(SuaveEnv):
    def advance(self, until, *, pause=False):
        kept = getattr(self, "_kept", [])
        self._kept = super().advance(until, pause=pause)
        return self._kept[-1:] + kept


class TellsNothing(SuaveEnv):
    def advance(self, until, *, pause=False):
        super().advance(until, pause=pause)
        return []


class TellsNumbers(SuaveEnv):
    def advance(self, until, *, pause=False):
        heard = super().advance(until, pause=pause)
        for message in heard:
            message["status"][0]["values"] = {"x": 1.0}
        return heard


class TellsMore(SuaveEnv):
    def advance(self, until, *, pause=False):
        return [{**message, "wall": 0} for message in super().advance(until, pause=pause)]


class SeesNothing(SuaveEnv):
    def observe(self):
        return dataclasses.replace(super().observe(), speed=math.nan)


class SeesTheStart(SuaveEnv):
    def observe(self):
        return dataclasses.replace(super().observe(), time=0.0)


class Overcharged(SuaveEnv):
    def observe(self):
        return dataclasses.replace(super().observe(), battery_level=1.01)


class LendsItsMessages(SuaveEnv):
    lent = ()

    def advance(self, until, *, pause=False):
        lost = bool(self.lent) and not self.lent[0]["status"]
        heard = super().advance(until, pause=pause)
        self.lent = heard[:1]
        return [] if lost else list(heard)


class LendsItsDisturbances(SuaveEnv):
    @property
    def disturbances(self):
        return self._disturbances


class RollsItsOwnDice(SuaveEnv):
    def observe(self):
        return dataclasses.replace(super().observe(), x=SHARED.random())


class KnowsNoChance(SuaveEnv):
    def __init__(self, settings, rng):
        super().__init__(settings, np.random.default_rng(3))


class CountsItsCalls(SuaveEnv):
    calls = 0

    def advance(self, until, *, pause=False):
        self.calls += 1
        return super().advance(until, pause=pause)

    def observe(self):
        return dataclasses.replace(super().observe(), speed=float(self.calls))


class Disobeys(SuaveEnv):
    def __init__(self, settings, rng):
        super().__init__(settings, rng)
        self.components.activate = self.components.deactivate


class KnowsEveryComponent(SuaveEnv):
    def __init__(self, settings, rng):
        super().__init__(settings, rng)
        known = self.components.is_active
        self.components.is_active = lambda name: name != "no such component" and known(name)


BROKEN = {
    RunsAhead: "ends at 0.3 s, not at",
    GoesBack: r"advance\(1.0\) at 2.0 s raises SuaveEnvError",
    TellsLate: "messages come in order of time",
    TellsNothing: "nothing was heard",
    TellsNumbers: "a status holds strings only",
    TellsMore: "a message has a time and a status",
    SeesNothing: "speed is nan",
    SeesTheStart: "the time observed is now",
    Overcharged: "a battery level is from 0 to 1",
    LendsItsMessages: "what is done with what was returned",
    LendsItsDisturbances: "what is done with what was returned",
    RollsItsOwnDice: "the same seed gives the same run",
    KnowsNoChance: "another seed gives another run",
    CountsItsCalls: "how time is sliced",
    Disobeys: "spiral_search is active when it was asked to be",
    KnowsEveryComponent: "an unknown component is refused",
}


@pytest.mark.parametrize(
    "changes", [{}, {"rules": "2025"}, {"battery": False, "thruster_events": "1 failure 3"}]
)
def test_the_sea_keeps_its_promises(changes):
    check_env(opened(**changes))


@pytest.mark.parametrize("kind", BROKEN, ids=lambda kind: kind.__name__)
def test_a_broken_environment_is_found_out(kind):
    with pytest.raises(BrokenEnvError, match=BROKEN[kind]):
        check_env(opened(kind, thruster_events="1 failure 3"))
    assert issubclass(BrokenEnvError, SuaveEnvError)


def test_a_component_that_it_does_not_manage_is_named():
    with pytest.raises(SuaveEnvError, match="there is no component 'spiral'"):
        check_env(opened(), "spiral")
