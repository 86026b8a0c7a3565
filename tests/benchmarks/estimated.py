"""Robots whose best configuration is to be found; the same for the same seed.

20 required functions with 5 designs of 1 to 3 components each, 30 components that the designs
share, with 3 configurations each. Every design, component and configuration is estimated to affect
three attributes, in steps of 0.01, which are weighed against one another. Components and
configurations use power too.
"""

from random import Random

from kb import KnowledgeBase, Model

__all__ = ["PREFERENCE", "robot", "small_robot"]

PREFERENCE = {"accuracy": 1.0, "speed": 0.5, "wear": -0.8}


def robot(seed: int) -> KnowledgeBase:
    """Return a knowledge base of a robot at rest, of which an action requires everything."""
    draw = Random(seed)
    model = Model(f"robot {seed}")
    for attribute in (*PREFERENCE, "power"):
        model.quality_attribute(attribute)
    components = [model.component(f"component {index}") for index in range(30)]
    for component in components:
        _estimate(component, draw, worst=-1.0)
        component.estimate("power", draw.randint(0, 500) / 100)
        for number in range(3):
            configuration = component.configuration(
                f"configuration {number} of {component.name}", priority=number
            )
            _estimate(configuration, draw, worst=-0.3)
            configuration.estimate("power", draw.randint(0, 500) / 100)
    functions = [model.function(f"function {index}", always_improve=True) for index in range(20)]
    for function in functions:
        for number in range(5):
            parts = draw.sample(components, draw.choice((1, 2, 3)))
            _estimate(
                function.design(f"design {number} of {function.name}", parts, priority=number),
                draw,
                worst=-1.0,
            )
    model.action("work", requires=functions)
    kb = KnowledgeBase(model, clock=lambda: 0.0)
    assert kb.request_action("work", PREFERENCE)
    return kb


def small_robot(seed: int) -> KnowledgeBase:
    """Return a knowledge base of a robot of which every joint choice can be tried.

    Some of it runs already.
    """
    draw = Random(seed)
    model = Model(f"small robot {seed}")
    for attribute in ("accuracy", "wear", "power"):
        model.quality_attribute(attribute)
    components = [
        model.component(f"component {index}", kind=draw.choice(("plain", "process")))
        for index in range(draw.randint(2, 4))
    ]
    for component in components:
        for number in range(draw.randint(0, 3)):
            component.configuration(
                f"configuration {number} of {component.name}", priority=draw.choice((1, 2, None))
            )
    functions = [
        model.function(f"function {index}", always_improve=True)
        for index in range(draw.randint(1, 3))
    ]
    for function in functions:
        for number in range(draw.randint(1, 3)):
            parts = draw.sample(components, draw.randint(1, 2))
            function.design(
                f"design {number} of {function.name}", parts, priority=draw.choice((1, 2, None))
            )
    for causer in (*model.designs.values(), *components, *model.configurations.values()):
        for attribute in ("accuracy", "wear", "power"):
            if draw.random() < 0.6:
                kind = draw.choice(("positive", "positive", "negative", "absolute"))
                causer.estimate(
                    attribute,
                    draw.randint(0, 30) / 10,
                    "positive" if attribute == "power" else kind,
                )
    model.action("work", requires=functions)
    kb = KnowledgeBase(model, clock=lambda: 0.0)
    assert kb.request_action("work")
    for component in kb.components.values():
        if draw.random() < 0.4:
            kb.component_active(component.name, True)
        if component.configurations and draw.random() < 0.4:
            kb.assert_selected(kb.configurations[draw.choice(component.configurations)], True)
    for function in kb.functions.values():
        if draw.random() < 0.4:
            kb.assert_selected(kb.designs[draw.choice(function.designs)], True)
    return kb


def _estimate(causer, draw: Random, worst: float) -> None:
    for attribute, weight in PREFERENCE.items():
        value = draw.randint(round(100 * worst), 100) / 100
        causer.estimate(attribute, abs(value), "positive" if value * weight > 0 else "negative")
