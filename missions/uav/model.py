"""The aerial vehicle: the paper's UAV use case (Silva et al., after Braberman et al.).

The battery and the gripper decide which action is feasible. By the paper's way of counting, the
model has 24 entities and 16 relations. Which functions an action needs is the paper's; which
components serve them is our own choice.
"""

from typing import Final

from kb import Model

# Charge that an action needs [1]; own choice: the way home takes less than 0.1, a pick-up twice as
# much as a look.
PICK_UP_LEVEL: Final = 0.55
SEARCH_LEVEL: Final = 0.3
ANALYSE_LEVEL: Final = 0.2

MOST_SAMPLES: Final = 8
"""Largest number of samples; the PDDL problem has an object for each."""

_FUNCTIONS: Final = {
    "generate_search_path": ["search_planner"],
    "detect_samples": ["sample_camera"],
    "generate_pick_up_path": ["pick_up_planner"],
    "grip_sample": ["gripper"],
    "analyse_held_sample": ["analyser"],
    "analyse_from_above": ["hover_planner", "infrared_camera"],
    "go_to_base": ["return_planner"],
    "fold_gripper": ["landing_planner", "folding_servo"],
}


def uav_model() -> Model:
    """Build the model; every call gives a new one, which may be extended."""
    model = Model("uav")
    battery = model.quality_attribute("battery_level", low=0.0, high=1.0)
    for function, components in _FUNCTIONS.items():
        parts = [model.component(name, kind="lifecycle") for name in components]
        model.function(function).design(f"by_{components[0]}", parts, priority=1)

    needs = ["generate_pick_up_path", "grip_sample", "analyse_held_sample"]
    search = model.action("search_for_samples", requires=["generate_search_path", "detect_samples"])
    search.constrain(battery >= SEARCH_LEVEL)
    model.action("pick_up_and_analyse", requires=needs).constrain(battery >= PICK_UP_LEVEL)
    model.action("analyse_on_site", requires=["analyse_from_above"]).constrain(
        battery >= ANALYSE_LEVEL
    )
    model.action("return_and_recharge", requires=["go_to_base"], restores=[battery])
    model.action("land_and_fold_gripper", requires=["fold_gripper"])
    return model
