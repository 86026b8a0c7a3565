"""All that a knowledge base answers, as a value.

And a life of one, the same each time, told to a store.
"""

import random
from contextlib import closing
from functools import partial

from clocks import Clock

from kb import KnowledgeBase, Model, PriorityPlanner
from kb.store import connect, events_in

KEPT = 50


def stored(path):
    """The events of a store that is closed."""
    with closing(connect(path)) as connection:
        return list(events_in(connection))


def answers(kb, *, ended=False):
    """Return everything that can be asked; with `ended`, as if what is open had been abandoned."""
    elements = [
        *kb.actions.values(),
        *kb.functions.values(),
        *kb.components.values(),
        *kb.designs.values(),
        *kb.configurations.values(),
    ]
    constraints = [one for element in elements for one in getattr(element, "constraints", ())]
    return {
        "statuses": [(repr(element), element.status) for element in (*elements, *constraints)],
        "required": [
            (repr(element), element.is_required)
            for element in elements
            if hasattr(element, "is_required")
        ],
        "active": [
            (component.name, component.is_active, dict(component.parameters_in_force))
            for component in kb.components.values()
        ],
        "selected": [
            repr(element) for element in elements if getattr(element, "is_selected", False)
        ],
        "measured": [
            (
                attribute.name,
                attribute.value,
                attribute.time,
                attribute.is_stale,
                attribute.history[-KEPT:],
            )
            for attribute in kb.attributes.values()
        ],
        "plans": [plan(one, ended) for one in kb.plans],
        "requests": [request(action) for action in kb.history.actions],
        "open": [action.action for action in kb.required_actions],
        "attempts": [attempt(one, ended) for one in kb.history.attempts],
        "processes": [
            (process.component, process.pid, process.start, process.end)
            for process in kb.history.processes
        ],
        "answers": [
            (kb.plans.index(answer.plan), answer.time, answer.is_vetoed, answer.reason)
            for answer in kb.history.answers
        ],
        "reasons": [
            design.reason for design in (*kb.designs.values(), *kb.configurations.values())
        ],
        "adaptable": (kb.adaptable_functions(), kb.adaptable_components(), kb.obsolete()),
    }


def plan(one, ended):
    result = "abandoned" if ended and one.end is None else one.result
    return (one.activate, one.deactivate, one.parameters, one.reason, one.start, result)


def attempt(one, ended):
    result = "abandoned" if ended and one.end is None else one.result
    reason = "its end is not known" if ended and one.end is None else one.reason
    return (
        str(one.plan),
        one.component,
        one.operation,
        one.configuration,
        dict(one.parameters),
        one.number,
        one.start,
        result,
        reason,
    )


def request(one):
    return (one.action, one.preference, one.start, one.end, one.result, one.reason)


def robot():
    """Return a model with something of everything."""
    model = Model("robot")
    light = model.environmental_attribute("light", max_age=40.0, when_stale="violated")
    energy = model.quality_attribute("energy", agreement=(2, 3))
    model.quality_attribute("load")
    camera = model.component("camera", kind="lifecycle", always_improve=True)
    camera.configuration("day", {"exposure": 0.01}, priority=1, constraints=[light >= 0.5])
    camera.configuration("night", {"exposure": 0.2}, priority=2, constraints=[light >= 0.1])
    lidar = model.component(
        "lidar", kind="process", constraints=[(energy >= 0.2).steady(hysteresis=0.1, dwell=3.0)]
    )
    see = model.function("see", always_improve=True)
    see.design("by camera", [camera], priority=1)
    see.design("by lidar", [lidar], priority=2)
    model.action("explore", requires=[see], constraints=[(energy >= 0.1).steady(hysteresis=0.2)])
    model.action("rest")
    camera.estimate(energy, 0.3, "negative")
    return model


class Life:
    """Steps of a life, decided by a seed and by what the base answers."""

    def __init__(self, path, seed, model=None):
        self.clock = Clock(0.0)
        self.chance = random.Random(seed)
        self.kb = KnowledgeBase(model or robot(), clock=self.clock, store=path, keep=KEPT)

    def moves(self):
        """Yield after each call that may tell something."""
        while True:
            self.clock.now += self.chance.choice((0.1, 0.5, 2.0))
            yield self.kb.revision  # what follows from time alone is told by itself
            for call, *arguments in self.calls(self.chance.randrange(12)):
                yield call(*arguments)

    def calls(self, what):
        kb = self.kb
        chance = self.chance
        if what < 5:
            yield kb.measure, chance.choice(("light", "energy", "load")), chance.random()
        elif what == 5 and chance.random() < 0.5:
            yield (
                kb.component_failed,
                chance.choice(("camera", "lidar")),
                chance.choice(("", "no 'luck'", "rain")),
            )
        elif what == 5:
            yield kb.component_recovered, chance.choice(("camera", "lidar"))
        elif what == 6:
            preference = chance.choice((None, "energy", {"energy": 2.0}))
            yield kb.request_action, chance.choice(("explore", "rest")), preference
        elif what == 7:
            yield (
                kb.cancel_action,
                chance.choice(("explore", "rest")),
                "failed",
                chance.choice(("", "no 'luck'\n\u00e9")),
            )
        elif what == 8:
            yield PriorityPlanner().plan, kb
        elif what == 9 and kb.pending_plan:
            yield from self.carrying_out(kb.pending_plan)
        elif what == 10:
            if kb.plans:
                given = {"exposure": chance.random(), "topics": ["a", "b"], "on": True, "n": 3}
                command = kb.plans[-1], "camera", "configure", "day", given
                yield kb.record_attempt, *command
                yield kb.finish_attempt, kb.history.attempts[-1], "completed"
        elif what == 11:
            running = [process for process in kb.history.processes if process.end is None]
            if running and chance.random() < 0.5:
                yield kb.component_ended, "lidar", running[0].pid
            else:
                yield kb.component_started, "lidar", chance.randrange(1000)
            lidar = kb.components["lidar"]
            status = chance.choice(("failure", "solved", None))
            until = chance.choice((None, self.clock.now + 5.0))
            yield (
                (kb.assert_status, lidar, status, "seen", until)
                if status
                else (kb.retract_status, lidar)
            )
            yield kb.assert_required, kb.functions["see"], chance.choice((True, None))
            yield kb.assert_selected, kb.designs["by lidar"], chance.choice((True, False))

    def carrying_out(self, plan):
        kb = self.kb
        chance = self.chance
        is_vetoed = chance.random() < 0.2
        yield (
            partial(
                kb.record_answer, plan, is_vetoed=is_vetoed, reason="not now" if is_vetoed else ""
            ),
        )
        for name in () if is_vetoed else (*plan.deactivate, *plan.activate):
            operation = "activate" if name in plan.activate else "deactivate"
            yield (partial(kb.record_attempt, plan, name, operation, parameters={"speed": 0.5}),)
            result = chance.choice(("completed", "completed", "failed", None))
            if result:
                yield kb.finish_attempt, kb.history.attempts[-1], result, "as told"
            yield kb.component_active, name, name in plan.activate
        yield kb.finish_plan, plan, chance.choice(("completed", "failed"))
