"""Stand-ins and a scripted mission for the tests of the simulated sea."""

import numpy as np

from suave_env import Settings, SuaveEnv


class Pilot:
    """Stands in for the autopilot: records setpoints; the vehicle is wherever the test puts it."""

    def __init__(self, position=(0.0, 0.0, -18.0), obedient=False):
        self.position = position
        self.sent = []
        self._obedient = obedient

    def go_to(self, target, time):
        self.sent.append((time, target))
        if self._obedient:
            self.position = target


def make_env(seed=0, **changes):
    return SuaveEnv(Settings().replace(**changes), np.random.default_rng(seed))


def values_of(messages, key):
    """Return (time, value) of every status that has the key."""
    return [
        (message["time"], status["values"][key])
        for message in messages
        for status in message["status"]
        if key in status["values"]
    ]


def altitude_for(visibility):
    return 3.0 if visibility >= 3.25 else 2.0 if visibility >= 2.25 else 1.0


class Script:
    """A task layer that hears messages only.

    Adaptive altitude, recovery, recharge below 0.25, follow when found.
    """

    def __init__(self, env, adaptive=True):
        self.env = env
        self.adaptive = adaptive
        self.messages = []
        self.found = False
        self.active = None
        self._altitude = None
        self._do("spiral_search")

    def _do(self, name):
        if self.active is not None:
            self.env.components.deactivate(self.active)
        self.env.components.activate(name)
        self.active = name

    def _hear(self, key, value):
        if (
            key == "water_visibility"
            and self.adaptive
            and altitude_for(float(value)) != self._altitude
        ):
            self._altitude = altitude_for(float(value))
            self.env.components.set_parameters("spiral_search", {"spiral_altitude": self._altitude})
        elif key == "pipeline_found":
            self.found = True
            self._do("follow_pipeline")
        elif value == "FALSE":
            self.env.components.activate("recover_thrusters")
        elif key == "c_thruster_6" and value == "RECOVERED":
            self.env.components.deactivate("recover_thrusters")
        elif key == "battery_level" and float(value) < 0.25 and self.active != "recharge":
            self._do("recharge")
        elif key == "battery_recharged":
            self._do("follow_pipeline" if self.found else "spiral_search")

    def run(self, until, step=0.1):
        ticks = round(self.env.now / step)
        while ticks * step < until:
            ticks += 1
            heard = self.env.advance(ticks * step)
            self.messages += heard
            for message in heard:
                for status in message["status"]:
                    for key, value in status["values"].items():
                        self._hear(key, value)
        return self
