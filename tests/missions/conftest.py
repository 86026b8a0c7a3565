"""What tests of several files have in common."""

import pytest


@pytest.fixture(params=["rosbridge", "rclpy"])
def robot(request):
    """The rover of `ros_rig`, by each wire."""
    from ros_rig import rig

    with rig(request.param) as made:
        yield made
