"""Three robots, one task: one tree, and a model for each robot."""

from py_trees.behaviour import Behaviour
from py_trees.behaviours import Running

from kb import KnowledgeBase, Model
from rosa_bt import ForAction, TreeRunner, first_feasible


def watch_over_a_field(kb: KnowledgeBase) -> Behaviour:
    """Return the task, which is the same for all of them."""
    names = ("watch_closely", "watch_from_afar", "wait")
    return first_feasible("watch", [ForAction(name, kb, name, Running(name)) for name in names])


def wheeled() -> Model:
    """Return a rover: mud is what stops it."""
    model = Model("rover")
    mud = model.environmental_attribute("mud_m")
    light = model.environmental_attribute("light")
    camera = model.component("camera", kind="lifecycle", always_improve=True)
    camera.configuration("wide", {"exposure_s": 0.01}, priority=1, constraints=[light >= 0.3])
    camera.configuration("long_exposure", {"exposure_s": 0.2}, priority=2)
    see = model.function("see")
    see.design("by_camera", [camera])
    model.action("watch_closely", requires=[see], constraints=[mud <= 0.05])
    model.action("watch_from_afar", requires=[see])
    model.action("wait")
    return model


def legged() -> Model:
    """Return a walker, which mud stops later; in the dark it sees by radar."""
    model = Model("walker")
    mud = model.environmental_attribute("mud_m")
    light = model.environmental_attribute("light")
    camera = model.component("camera", kind="lifecycle")
    camera.configuration("stereo", {"baseline_m": 0.1}, constraints=[light >= 0.2])
    see = model.function("see", always_improve=True)
    see.design("by_camera", [camera], priority=1)
    see.design("by_radar", [model.component("radar", kind="lifecycle")], priority=2)
    model.action("watch_closely", requires=[see], constraints=[mud <= 0.3])
    model.action("watch_from_afar", requires=[see])
    model.action("wait")
    return model


def flying() -> Model:
    """Return a drone: mud is nothing to it, light is everything."""
    model = Model("drone")
    model.environmental_attribute("mud_m")
    light = model.environmental_attribute("light")
    camera = model.component("camera", kind="lifecycle")
    camera.configuration("gimbal", {"tilt_deg": 60}, constraints=[light >= 0.2])
    see = model.function("see")
    see.design("by_camera", [camera])
    model.action("watch_closely", requires=[see])
    model.action("watch_from_afar", requires=[see])
    model.action("wait")
    return model


situations = {"a dry day": (0.0, 0.9), "a wet day": (0.1, 0.9), "a wet night": (0.1, 0.05)}
print(" ".join([f"{'':12}", *(f"{name:<32}" for name in ("rover", "walker", "drone"))]).rstrip())
for name, (mud_m, brightness) in situations.items():
    cells = []
    for model in (wheeled(), legged(), flying()):
        kb = KnowledgeBase(model, clock=lambda: 0.0)
        kb.measure("mud_m", mud_m)
        kb.measure("light", brightness)
        runner = TreeRunner(watch_over_a_field(kb), clock=lambda: 0.0)
        runner.tick()
        (doing,) = (required.action for required in kb.required_actions)
        best = kb.situation().best_configuration(doing)
        how = [] if best is None else [*best.designs.values(), *best.configurations.values()]
        cells.append(f"{doing} {'+'.join(how[-1:])}")
        runner.shutdown()
    print(" ".join([f"{name:<12}", *(f"{cell:<32}" for cell in cells)]).rstrip())
