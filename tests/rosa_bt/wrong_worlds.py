"""A robot that reacts and one that decides by worth are told the same: forecasts, sensors and clock are wrong."""

from random import Random

from acting import Act

from kb import ConfigurationManager, KnowledgeBase, Model
from kb.elements import Rate
from rosa_bt import Detour, Gain, Lookahead, MissionValue, ValueSelector, first_feasible

FAULTS = ("bias", "spikes", "dead sensor", "clock")


class Managed:
    def activate(self, component): ...
    def deactivate(self, component): ...
    def set_parameters(self, component, parameters): ...


def model_of(chance):
    model = Model("mower")
    attributes = [
        model.quality_attribute("charge", low=0.0, high=1.0),
        model.environmental_attribute("light"),
    ]
    charge, light = attributes
    blade = model.component("blade", always_improve=True)
    blade.configuration("fast", {"speed": 2.0}, priority=1, constraints=[light >= 0.5])
    blade.configuration("slow", {"speed": 1.0}, priority=2)
    model.action(
        "mow", requires=[model.function("cut").design("with_blade", [blade], priority=1).function]
    )
    model.actions["mow"].constrain(charge >= 0.25)
    model.actions["mow"].constrain(light >= 0.1)
    model.action("dock")
    for one in attributes:
        wrong = chance.choice(("constant", "trend"))
        rates = [
            Rate(chance.choice((-1.0, -0.03, -0.01, 0.01)), action, chance.random() < 0.5)
            for action in ("", "mow")
        ]
        if chance.random() < 0.5:
            model.change(one, forecasting=wrong, rates=())
        else:
            model.change(one, rates=chance.sample(rates, chance.randint(1, 2)))
    return model


class Robot:
    """One of the two; `violates` names what it does or is configured as against a constraint, as far as it is told."""

    def __init__(self, case, looks_ahead):
        chance, self.now = Random(case), 0.0
        self.kb = kb = KnowledgeBase(model_of(chance), clock=lambda: self.now)
        tasks = [Act(kb, "mow"), Act(kb, "dock")]
        away = chance.choice((-0.1, 0.3, 1.0))
        gains = [Gain("mow", chance.uniform(0, 2), chance.random(), away)]
        takes, spread = chance.uniform(0, 8), chance.uniform(0, 0.5)
        dock = Detour(
            "dock", {"charge": 1.0}, lambda away: takes + away, lambda away: takes + away, spread
        )
        keep = {"charge": 0.1} if chance.random() < 0.3 else {}
        self.lookahead = Lookahead(kb, MissionValue(chance.uniform(40, 120), gains, [dock], keep))
        self.manager = ConfigurationManager(kb, Managed())
        tree = (
            ValueSelector("what next", self.lookahead, tasks)
            if looks_ahead
            else first_feasible("what next", tasks)
        )
        self.tree = tree

    def told(self, now, measured):
        self.now = now
        for name, value in measured.items():
            self.kb.measure(name, value)
        self.manager.update()
        self.tree.tick_once()
        self.manager.update()

    @property
    def violates(self):
        kb = self.kb
        done = [kb.actions[one.action] for one in kb.required_actions]
        chosen = [
            one for one in (*kb.configurations.values(), *kb.designs.values()) if one.is_selected
        ]
        in_use = chosen if done else []
        return {
            one.name
            for one in (*done, *in_use)
            for each in one.constraints
            if each.status.value == "violated"
        }


def wrong_case(case):
    """Go through a case; return what only the one that looks ahead violates, and how often it put off mowing."""
    chance, ahead, reactive = Random(case), Robot(case, True), Robot(case, False)
    fault, bias, clock, charge, put_off, only = (
        chance.choice(FAULTS),
        chance.uniform(-0.5, 0.5),
        0.0,
        1.0,
        0,
        set(),
    )
    for step in range(20):
        clock += chance.choice((0.1, 1.0, 1.0, 3.0))
        if fault == "clock":
            clock = max(0.0, clock + chance.choice((0.0, 0.0, 0.0, -0.5, 30.0, 1000.0)))
        charge = max(0.0, charge - chance.uniform(0.0, 0.1)) if chance.random() < 0.9 else 1.0
        measured = {"charge": charge, "light": chance.random()}
        if fault == "bias":
            measured["charge"] += bias
        if fault == "spikes" and chance.random() < 0.3:
            measured[chance.choice(("charge", "light"))] = chance.choice((-1e9, 0.0, 1e9))
        if fault == "dead sensor" and step > 2:
            del measured[("charge", "light")[case % 2]]
        if "charge" in measured:
            measured["charge"] = min(1.0, max(0.0, measured["charge"]))  # else it is refused
        for robot in (ahead, reactive):
            robot.told(clock, measured)
        only |= ahead.violates - reactive.violates
        put_off += reactive.kb.is_feasible("mow") and not ahead.kb.is_feasible("mow")
        if ahead.kb.is_feasible("mow") and not reactive.kb.is_feasible("mow"):
            only.add("feasible by a forecast")
    for robot in (ahead, reactive):
        robot.told(clock + 1000.0, {})
    if reactive.kb.is_feasible("mow") and not ahead.kb.is_feasible("mow"):
        only.add("put off for ever")
    return only, put_off
