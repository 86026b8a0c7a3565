"""The rover's lifecycle nodes and its rosbridge: `ros2 launch ./rover.launch.py`."""

from launch_ros.actions import LifecycleNode, Node

from launch import LaunchDescription


def generate_launch_description() -> LaunchDescription:
    """Return what is started; lifecycle nodes stay unconfigured until they are needed."""
    nodes = [
        LifecycleNode(
            package="rover_camera",
            executable="camera",
            name="camera",
            namespace="front",
            parameters=["params.yaml"],
        ),
        LifecycleNode(
            package="rover_lidar",
            executable="lidar",
            name="lidar",
            namespace="",
            parameters=["params.yaml"],
        ),
        LifecycleNode(
            package="rover_nav",
            executable="navigator",
            name="navigator",
            namespace="",
            parameters=["params.yaml"],
        ),
        Node(
            package="rosbridge_server",
            executable="rosbridge_websocket",
            parameters=[{"address": "127.0.0.1", "port": 9090}],
        ),
    ]
    return LaunchDescription(nodes)
