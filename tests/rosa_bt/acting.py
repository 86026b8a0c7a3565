"""A clock and an action, for trees that are ticked by hand."""

from py_trees.common import Status

from rosa_bt import RosaAction


class Clock:
    now = 0.0

    def __call__(self):
        return self.now


class Act(RosaAction):
    """Runs until it is stopped."""

    def __init__(self, kb, action):
        super().__init__(action, kb, action)

    def update(self):
        return Status.RUNNING
