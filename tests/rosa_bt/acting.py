"""A clock, an action and a robot, for trees that are ticked by hand."""

from py_trees.common import Status

from kb import Model
from rosa_bt import RosaAction


def rover():
    """Return a model with an action that needs light, and one that needs nothing."""
    model = Model("rover")
    model.action("scan", constraints=[model.environmental_attribute("light") >= 0.5])
    model.action("rest")
    return model


class Clock:
    now = 0.0

    def __call__(self):
        return self.now


class Act(RosaAction):
    """Runs until it is stopped, or its result is set."""

    result = Status.RUNNING
    begun = 0

    def __init__(self, kb, action, **options):
        super().__init__(action, kb, action, **options)

    def initialise(self):
        self.begun += 1

    def update(self):
        return self.result


class Managed:
    """Does at once what it is commanded."""

    def activate(self, component): ...
    def deactivate(self, component): ...
    def set_parameters(self, component, parameters): ...
