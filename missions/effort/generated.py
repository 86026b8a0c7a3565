"""Models of any size that are as small as the ROSA paper's assumptions on scalability let them be."""

from kb import Model
from kb.elements import Attribute, Component, Function
from missions.engine.mission import MissionError

__all__ = ["generated_model"]


def generated_model(structural: int, parameter: int, actions: int = 1) -> Model:
    """Make the smallest model for a number of adaptations (Silva et al., assumptions 1 and 2).

    Each action requires a function of its own, with one design of one component with one configuration. A structural
    adaptation is one more such design, a parameter adaptation one more configuration of the first component. Every
    design and every configuration has a priority and a constraint; every component a package, an executable and one
    parameter. All constraints are on the one quality attribute, which all actions share.

    Args:
        structural: structural adaptations of each action, from 0.
        parameter: parameter adaptations of each action, from 0.
        actions: how many, from 1.

    Raises:
        MissionError: a number is too small.
    """
    for name, number, least in (("structural", structural, 0), ("parameter", parameter, 0), ("actions", actions, 1)):
        if number < least:
            raise MissionError(f"{name} is {number}; a generated model takes a whole number from {least}")
    model = Model("generated")
    quality = model.quality_attribute("quality")
    for one in range(1, actions + 1):
        function = model.function(f"function_{one}")
        first, *_ = [_design(function, quality, f"{one}_{number}", number) for number in range(1, structural + 2)]
        for number in range(2, parameter + 2):
            _configuration(first, quality, number)
        model.action(f"action_{one}", requires=[function])
    return model


def _design(function: Function, quality: Attribute, name: str, number: int) -> Component:
    component = function.model.component(f"node_{name}", kind="process", package="nodes", executable=f"node_{name}")
    _configuration(component, quality, 1)
    function.design(f"design_{name}", [component], priority=number, constraints=[quality >= 1 / number])
    return component


def _configuration(component: Component, quality: Attribute, number: int) -> None:
    name = f"{component.name}_as_{number}"
    component.configuration(name, {"value": number}, priority=number, constraints=[quality >= 1 / number])
