"""A story decided once more by `rosa_bt.replay_trace`: each tick has its time, and leaves answer as in the story."""

from math import nan

from missions.proof.rig import Surroundings, take_over
from missions.proof.tape import Choices
from rosa_bt import replay_trace


class Played(Choices):
    def __init__(self, scripts, clock):
        super().__init__()
        self._scripts, self._clock, self._at = scripts, clock, nan

    def choose(self, leaf, letters):
        if self._clock() != self._at:
            self._at = self._clock()
            self.begin(self._scripts.get(self._at, ()))
        return super().choose(leaf, letters)


def replayed(setup, story, trail):
    """Return the trace of a story decided once more; it equals the story's own."""
    scripts = {float(number): step.answers for number, step in enumerate(trail, start=1)}

    def build(kb):
        root = setup.tree(kb)
        values = Surroundings(kb, root, **setup.surroundings).values
        take_over(root, kb, setup.leaves, values, Played(scripts, lambda: kb.now))
        return root

    return replay_trace(story.trace, setup.model(), build)
