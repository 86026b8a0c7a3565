"""The other side of the contract of nodes: hands back what it hears, serves, and calls what it is told to.

As a program it does so over DDS: `python ros_peer.py DOMAIN`, until its input ends.
"""

import json
import sys

from missions.wires.node import RosError

ARRAY, STRING = "std_msgs/msg/Float64MultiArray", "std_msgs/msg/String"
DIAGNOSTICS, ASK = "diagnostic_msgs/msg/DiagnosticArray", "rosa_msgs/srv/ActionQuery"


def attend(node):
    for name, kind in (("array", ARRAY), ("diagnostics", DIAGNOSTICS)):
        node.subscribe(
            f"/to/{name}", kind, lambda one, n=name, k=kind: node.publish(f"/from/{n}", k, one)
        )
    node.subscribe("/to/text", STRING, lambda one: node.publish("/from/text", STRING, one))
    node.subscribe("/call", STRING, lambda one: call(node, **json.loads(one["data"])))
    node.serve("/peer/ask", ASK, lambda one: {"action": one["action"], "success": True})
    node.serve("/peer/refuse", ASK, refuse)
    node.serve("/peer/fail", ASK, lambda one: one["nothing"])


def refuse(_):
    raise RosError("never")


def call(node, service, request):
    def say(future):
        answer = {"failed": str(future.exception())} if future.exception() else future.result()
        node.publish("/called", STRING, {"data": json.dumps(answer)})

    node.call(service, ASK, request).add_done_callback(say)


if __name__ == "__main__":
    from missions.wires.dds import DdsNode

    attending = DdsNode(int(sys.argv[1]))
    attend(attending)
    print("attending", flush=True)
    sys.stdin.read()
    attending.close()
