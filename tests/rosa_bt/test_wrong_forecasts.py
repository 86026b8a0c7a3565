"""A forecast that is wrong on purpose costs some worth and never safety."""

import logging
from random import Random

from acting import Act, Clock

from kb import KnowledgeBase, Model
from kb.elements import Rate
from rosa_bt import do_until_unfeasible

CASES = 240


WAYS = ("", "constant", "trend")


def robot(chance):
    """Return a model with some constraints on two attributes, whose forecasts say whatever they like."""
    model = Model("robot")
    attributes = [
        model.quality_attribute(
            name,
            forecasting=chance.choice(WAYS),
            rates=[
                Rate(chance.choice((-1e3, -0.1, 0.0, 0.1, 1e3)), action, chance.random() < 0.5)
                for action in ("", "work", "rest")
                if chance.random() < 0.3
            ],
        )
        for name in ("energy", "light")
    ]

    def some():
        one, value = chance.choice(attributes), chance.choice((0.25, 0.5, 0.75))
        return chance.choice((one >= value, one <= value, one > value, one < value))

    camera = model.component("camera")
    for number in range(chance.randint(0, 3)):
        camera.configuration(
            f"c{number}", {"n": number}, constraints=[some() for _ in range(chance.randint(0, 1))]
        )
    see = model.function("see")
    see.design("by camera", [camera], constraints=[some()] if chance.random() < 0.3 else [])
    model.action("work", requires=[see], constraints=[some() for _ in range(chance.randint(0, 2))])
    model.action("rest")
    return model


def feasible(base):
    """Return all that could be done or selected."""
    return {
        *base.selectable_actions(),
        *(("camera", one) for one in base.selectable_configurations("camera")),
        *(("see", one) for one in base.selectable_designs("see")),
    }


def test_wrong_forecasts_only_add_caution_in_random_cases():
    logging.disable(logging.ERROR)
    careful = idle = 0
    try:
        for case in range(CASES):
            chance, clock = Random(case), Clock()
            kb = KnowledgeBase(robot(chance), clock=clock)
            tree = do_until_unfeasible(
                Act(kb, "work"), Act(kb, "rest"), during=chance.choice((0.0, 5.0, 60.0))
            )
            time = 1.0
            for _ in range(14):
                time += chance.choice(
                    (0.0, 0.1, 1.0, 1.0, 1.0, 1000.0)
                )  # a clock that jumps, and back a little
                clock.now = time - chance.choice((0.0, 0.0, 0.0, 0.5))
                for name in ("energy", "light"):
                    if (
                        chance.random() < 0.8
                    ):  # a sensor that is silent now and then, and sometimes mad
                        kb.measure(name, chance.choice((0.1, 0.4, 0.6, 0.6, 0.9, 1e9, -1e9)))
                if chance.random() < 0.3:
                    tree.tick_once()
                    doing = {one.action for one in kb.required_actions}
                    assert all(map(kb.is_feasible, doing)), (
                        case
                    )  # as the reactive tree would have kept it
                    idle += "rest" in doing and kb.is_feasible("work")
            ahead = kb.now + chance.choice((0.0, 1.0, 30.0, 1e4))
            now, then = feasible(kb), feasible(kb.situation(at=ahead))
            assert then <= now, case
            careful += then < now
            until = kb.feasible_until("work", 60.0)
            assert kb.is_feasible("work") or until.at == kb.now, case
            assert until.earliest is None or until.at is None or until.earliest <= until.at, case
    finally:
        logging.disable(logging.NOTSET)
    assert careful > 5  # it does look ahead,
    assert idle > 5  # and that has its price
