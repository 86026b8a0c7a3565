"""The model of the vehicle that searches for a pipeline and inspects it.

The knowledge is that of the SUAVE use case in the ROSA paper (Silva et al., section on
feasibility): two ways to maintain motion answer a thruster failure, three search altitudes answer
the visibility of the water.
"""

from kb import Model


def suave_model(name: str = "suave") -> Model:
    """Build the model; every call gives a new one, which may be extended."""
    model = Model(name)
    visibility = model.environmental_attribute("water_visibility", unit="m", low=0.0)
    visibility.forecast("constant")

    # What the vehicle is made of. Thrusters are plain hardware: they fail, but nobody switches
    # them.
    thrusters = [model.component(f"c_thruster_{number}") for number in range(1, 7)]
    spiral_search = model.component("spiral_search", kind="lifecycle", always_improve=True)
    follow_pipeline = model.component("follow_pipeline", kind="lifecycle")
    recover_thrusters = model.component("recover_thrusters", kind="lifecycle")

    # The higher it searches, the more the camera sees, and the clearer the water has to be.
    for priority, (configuration, altitude_m, needed_visibility_m) in enumerate(
        [("high_altitude", 3.0, 3.25), ("medium_altitude", 2.0, 2.25), ("low_altitude", 1.0, 1.25)],
        start=1,
    ):
        spiral_search.configuration(
            configuration,
            {"spiral_altitude": altitude_m},
            priority=priority,
            constraints=[visibility >= needed_visibility_m],
        )

    # The functions, and the components that serve them.
    generate_search_path = model.function("generate_search_path")
    generate_search_path.design("spiral", [spiral_search], priority=1)
    inspect_path = model.function("generate_inspection_path")
    inspect_path.design("follow", [follow_pipeline], priority=1)
    maintain_motion = model.function("maintain_motion", always_improve=True)
    maintain_motion.design("all_thrusters", thrusters, priority=1)
    maintain_motion.design("thruster_recovery", [recover_thrusters], priority=2)

    # The actions, and the functions that they require.
    model.action("search_pipeline", requires=[generate_search_path, maintain_motion])
    model.action("inspect_pipeline", requires=[inspect_path, maintain_motion])
    return model
