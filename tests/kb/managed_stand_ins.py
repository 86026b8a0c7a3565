"""Managed systems that do as they are scripted: at once, slowly, wrongly, or never."""

from models import Clock

from kb import KnowledgeBase, Model


class Broken(Exception):
    pass


LIE = object()
"""In a script: said to be done at once, and not done."""


class Operation:
    """Ends at a time of the clock, well or badly."""

    def __init__(self, clock, ends, effect, error):
        self.clock = clock
        self.ends = ends
        self.effect = effect
        self.error = error

    def done(self):
        if self.clock.now < self.ends:
            return False
        if self.effect is not None and self.error is None:
            self.effect()
            self.effect = None
        return True

    def exception(self):
        assert self.done(), "asked before it has ended"
        return self.error


class Scripted:
    """A managed system.

    `script` holds, by "verb component", what its next commands do, the last again and again: None
    is done at once, a number takes that long [s], an exception is raised, a pair of a number and an
    exception fails after that time, a LIE does nothing.
    """

    def __init__(self, clock, script=None, default=None):
        self.clock = clock
        self.script = {key: list(value) for key, value in (script or {}).items()}
        self.default = default
        self.log = []
        self.running = set()
        self.parameters = {}
        self.started_with = {}

    def _do(self, verb, component, effect, parameters=None):
        self.log.append(
            f"{verb} {component}"
            if parameters is None
            else f"{verb} {component} {dict(parameters)}"
        )
        steps = self.script.get(f"{verb} {component}", [self.default])
        step = steps.pop(0) if len(steps) > 1 else steps[0]
        if isinstance(step, Exception):
            raise step
        if step is LIE:
            return None
        if step is None:
            effect()
            return None
        lasts, error = step if isinstance(step, tuple) else (step, None)
        return Operation(self.clock, self.clock.now + lasts, effect, error)

    def activate(self, component):
        def effect():
            self.running.add(component)
            self.started_with[component] = self.parameters.get(component)

        return self._do("activate", component, effect)

    def deactivate(self, component):
        return self._do("deactivate", component, lambda: self.running.discard(component))

    def set_parameters(self, component, parameters):
        return self._do(
            "configure",
            component,
            lambda: self.parameters.__setitem__(component, dict(parameters)),
            parameters,
        )


class Candid(Scripted):
    """One that can tell what is running, whatever it said of its commands."""

    def is_active(self, component):
        return component in self.running


def rover(**camera):
    """Sees by camera (two configurations) or by lidar.

    A lamp without a driver belongs to the camera's design.
    """
    model = Model("rover")
    light = model.environmental_attribute("light")
    node = model.component("camera", **{"kind": "lifecycle", **camera})
    node.configuration("day", {"exposure": 0.01}, priority=1, constraints=[light >= 0.5])
    node.configuration("night", {"exposure": 0.2}, priority=2)
    model.component("lidar", kind="process")
    model.component("lamp")
    see = model.function("see")
    see.design("by camera", ["camera", "lamp"], priority=1)
    see.design("by lidar", ["lidar"], priority=2)
    model.action("explore", requires=[see])
    return model


def base(model, now=100.0):
    clock = Clock(now)
    return KnowledgeBase(model, clock=clock), clock


def happen(kb, event):
    """Let something happen to a base that a manager changes, too."""
    what, *arguments = event
    names = {"request": "request_action", "cancel": "cancel_action", "measure": "measure"}
    getattr(kb, names.get(what, f"component_{what}"))(*arguments)


def turn(manager, clock, times=1, seconds=1.0):
    """Take turns of the loop, with time passing between; return the plans made."""
    plans = []
    for _ in range(times):
        plan = manager.update()
        if plan is not None:
            plans.append(plan)
        clock.now += seconds
    return plans


def come_to_rest(manager, kb, clock, most=60, quiet=6):
    """Take turns until nothing has been planned for a while.

    Return the plans, or fail when it never rests.
    """
    plans = []
    still = 0
    for _ in range(most):
        made = turn(manager, clock)
        plans += made
        still = 0 if made or kb.pending_plan is not None else still + 1
        if still >= quiet:
            return plans
    raise AssertionError(f"still planning after {most} turns; the last plans: {plans[-4:]}")
