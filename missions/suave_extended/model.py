"""The model of SUAVE with a battery, which adds one attribute, one action and two constraints."""

from kb import Model
from missions.suave.model import suave_model


def suave_extended_model() -> Model:
    """Build the model; searching and inspecting need a quarter of the battery."""
    model = suave_model("suave_extended")
    battery = model.quality_attribute("battery_level", low=0.0, high=1.0)
    battery.changes(
        -1 / 200, learns=True
    )  # the experiment's setting, until the real rate is learned
    recharge = model.component("recharge", kind="lifecycle")
    generate_recharge_path = model.function("generate_recharge_path")
    generate_recharge_path.design("to_station", [recharge], priority=1)
    model.action(
        "recharge",
        requires=[generate_recharge_path, "maintain_motion"],
        restores=[battery],
    )
    model.actions["search_pipeline"].constrain(battery >= 0.25)
    model.actions["inspect_pipeline"].constrain(battery >= 0.25)
    return model
