"""rclpy, rosidl_runtime_py and message packages, as far as the product uses them.

Names, parameters and checks of types are those of the real ones; whatever else is used raises.
Nodes of one process meet; callbacks run in the thread that spins, and what a callback raises ends
it, as there. A `RobotHost` carries a robot of `ros_robot`. What an action client gets is what was
recorded (data/ros2_transcripts.json).
"""

import sys
import time
from base64 import b64encode
from contextlib import contextmanager, suppress
from enum import IntEnum
from queue import Empty, Queue
from threading import RLock
from types import ModuleType, SimpleNamespace
from typing import ClassVar

from missions.wires import ros
from missions.wires.rclpy import Messages
from missions.wires.ros import to_message, to_object

_IDL = {
    "bool": "boolean",
    "byte": "octet",
    "char": "uint8",
    "float32": "float",
    "float64": "double",
}
_LOCK = RLock()
_NODES, _CLASSES = [], {}


class ReliabilityPolicy(IntEnum):
    SYSTEM_DEFAULT = 0
    RELIABLE = 1
    BEST_EFFORT = 2


class DurabilityPolicy(IntEnum):
    SYSTEM_DEFAULT = 0
    TRANSIENT_LOCAL = 1
    VOLATILE = 2


class QoSProfile:
    def __init__(self, **kwargs):
        assert "depth" in kwargs, "History and/or depth settings are required."
        assert set(kwargs) <= {"depth", "reliability", "history", "durability"}, "Unknown argument"
        self.depth = kwargs["depth"]
        self.reliability = kwargs.get("reliability", ReliabilityPolicy.RELIABLE)
        self.durability = kwargs.get("durability", DurabilityPolicy.VOLATILE)

    def serves(self, asked):
        """Return whether a subscription with another profile hears a publisher with this one."""
        is_reliable = self.reliability == ReliabilityPolicy.RELIABLE
        is_latched = self.durability == DurabilityPolicy.TRANSIENT_LOCAL
        return (is_reliable or asked.reliability != ReliabilityPolicy.RELIABLE) and (
            is_latched or asked.durability != DurabilityPolicy.TRANSIENT_LOCAL
        )


class ExternalShutdownException(Exception): ...


class ShutdownException(Exception): ...


class Context:
    def __init__(self):
        self.is_open = False

    def ok(self):
        return self.is_open


def init(*, args=None, context=None, domain_id=None):
    assert not context.is_open, "Context.init() must only be called once"
    context.is_open = True


def shutdown(*, context=None, uninstall_handlers=None):
    assert context.is_open, "Cannot shutdown a ROS adapter that is not running"
    context.is_open = False


def create_node(node_name, *, context=None, namespace=None):
    assert context.is_open, "the given context is not valid"
    return Node(node_name, context=context)


class Future:
    def __init__(self):
        self._done, self._result, self._exception, self._callbacks = False, None, None, []

    def result(self):
        if self._exception:
            raise self._exception
        return self._result

    def exception(self):
        return self._exception

    def add_done_callback(self, callback):
        if self._done:
            callback(self)
        self._callbacks.append(callback)

    def set_result(self, result):
        self._done, self._result = True, result
        for callback in self._callbacks:
            callback(self)


class Publisher:
    def __init__(self, msg_type, topic, qos_profile):
        self.msg_type, self.topic, self.qos_profile, self.last = msg_type, topic, qos_profile, None

    def publish(self, msg):
        assert isinstance(msg, self.msg_type), f"Expected {self.msg_type}, got {type(msg)}"
        with _LOCK:
            self.last = msg
            for node in _NODES:
                for one in node.subscriptions:
                    if one.topic == self.topic and self.qos_profile.serves(one.qos_profile):
                        assert one.msg_type is self.msg_type
                        node.todo.put(lambda one=one: one.callback(msg))


class Client:
    def __init__(self, node, srv_type, srv_name):
        self.node, self.srv_type, self.srv_name = node, srv_type, srv_name

    def _server(self):
        with _LOCK:
            found = [
                (node, s) for node in _NODES for s in node.services if s.srv_name == self.srv_name
            ]
        return found[0] if found else None

    def service_is_ready(self):
        return self._server() is not None

    def call_async(self, request):
        if not isinstance(request, self.srv_type.Request):
            raise TypeError
        future, (node, service) = Future(), self._server()

        def serve():
            response = service.callback(request, service.srv_type.Response())
            if response is not None:
                assert isinstance(response, service.srv_type.Response)
                self.node.todo.put(lambda: future.set_result(response))

        serve() if node.is_robot else node.todo.put(serve)
        return future


class ActionClient:
    def __init__(self, node, action_type, action_name):
        self.node, self.kind, self.name = node, action_type.name, action_name

    def send_goal_async(self, goal, feedback_callback=None, goal_uuid=None):
        assert type(goal) is _class(f"{self.kind}_Goal")
        response, result, types = Future(), Future(), Messages()
        server = RobotHost.actions.get(self.name)

        def show(values):
            feedback = to_object(types, f"{self.kind}_Feedback", values)
            message = SimpleNamespace(goal_id=None, feedback=feedback)
            self.node.todo.put(lambda: feedback_callback(message))

        def end(status, values):
            answer = to_object(types, f"{self.kind}_Result", values)
            self.node.todo.put(
                lambda: result.set_result(SimpleNamespace(status=status, result=answer))
            )

        key = (
            None
            if server is None
            else server.begin(to_message(types, f"{self.kind}_Goal", goal), show, end)
        )
        if key is not None:  # else it never completes, even if a server comes later
            handle = GoalHandle(self.node, server, key, result)
            self.node.todo.put(lambda: response.set_result(handle))
        return response


class GoalHandle:
    status = 0

    def __init__(self, node, server, key, result):
        self.node, self.server, self.key, self.accepted, self._result = (
            node,
            server,
            key,
            bool(key),
            result,
        )

    def get_result_async(self):
        return self._result

    def cancel_goal_async(self):
        answered, is_cancelling = Future(), self.server.cancel(self.key)
        if is_cancelling is not None:
            goals = [self.key] if is_cancelling else []
            answer = SimpleNamespace(return_code=0, goals_canceling=goals)
            self.node.todo.put(lambda: answered.set_result(answer))
        return answered


class Node:
    is_robot = False

    def __init__(self, node_name, *, context=None):
        self.name, self.context, self.todo = node_name, context, Queue()
        self.subscriptions, self.publishers, self.services, self.timers = [], [], [], []
        with _LOCK:
            _NODES.append(self)

    def create_publisher(self, msg_type, topic, qos_profile):
        made = Publisher(_message(msg_type), _name(topic), _quality(qos_profile))
        self.publishers.append(made)
        return made

    def create_subscription(self, msg_type, topic, callback, qos_profile):
        made = SimpleNamespace(
            msg_type=_message(msg_type),
            topic=_name(topic),
            callback=callback,
            qos_profile=_quality(qos_profile),
        )
        with _LOCK:
            self.subscriptions.append(made)
            for publisher in [
                one for node in _NODES for one in node.publishers if one.topic == topic
            ]:
                is_latched = made.qos_profile.durability == DurabilityPolicy.TRANSIENT_LOCAL
                if (
                    publisher.last is not None
                    and is_latched
                    and publisher.qos_profile.serves(made.qos_profile)
                ):
                    self.todo.put(lambda last=publisher.last: callback(last))
        return made

    def destroy_subscription(self, subscription):
        with _LOCK:
            self.subscriptions.remove(subscription)
        return True

    def create_client(self, srv_type, srv_name):
        return Client(self, _service(srv_type), _name(srv_name))

    def create_service(self, srv_type, srv_name, callback):
        with _LOCK:
            self.services.append(
                SimpleNamespace(
                    srv_type=_service(srv_type), srv_name=_name(srv_name), callback=callback
                )
            )

    def create_timer(self, timer_period_sec, callback):
        self.timers.append((float(timer_period_sec), callback))

    def get_publishers_info_by_topic(self, topic_name, no_mangle=False):
        with _LOCK:
            return [
                SimpleNamespace(qos_profile=one.qos_profile)
                for node in _NODES
                for one in node.publishers
                if one.topic == topic_name
            ]

    def destroy_node(self):
        with _LOCK:
            _NODES.remove(self)


class SingleThreadedExecutor:
    def __init__(self, *, context=None):
        assert context.is_open
        self.context, self.node, self.is_shut = context, None, False

    def add_node(self, node):
        self.node = node
        return True

    def spin(self):
        due = 0.0
        while not self.is_shut:
            if not self.context.is_open:
                raise ExternalShutdownException
            with suppress(Empty):
                self.node.todo.get(timeout=0.02)()
            if time.monotonic() >= due:
                for period, callback in self.node.timers:
                    callback()
                    due = time.monotonic() + period

    def shutdown(self, timeout_sec=None):
        self.is_shut = True
        return True


class RobotHost:
    """Carries a robot of `ros_robot`; it answers at once, and needs no thread."""

    actions: ClassVar = {}

    def __init__(self):
        self.types, self.node, self.actions = Messages(), Node("robot"), RobotHost.actions
        self.node.is_robot = True
        self.actions.clear()

    def serve(self, service, kind, answer):
        def respond(request, _):
            values = answer(_with_texts(to_message(self.types, f"{kind}_Request", request)))
            return None if values is None else to_object(self.types, f"{kind}_Response", values)

        self.unserve(service)
        self.node.create_service(self.types.find(kind), service, respond)

    def unserve(self, service):
        self.node.services = [one for one in self.node.services if one.srv_name != service]

    def advertise(self, topic, kind, *, is_latched=False):
        durability = DurabilityPolicy.TRANSIENT_LOCAL if is_latched else DurabilityPolicy.VOLATILE
        quality = QoSProfile(depth=10, durability=durability)
        self.unadvertise(topic)
        self.node.create_publisher(self.types.find(kind), topic, quality)

    def unadvertise(self, topic):
        self.node.publishers = [one for one in self.node.publishers if one.topic != topic]

    def has_hearer(self, topic):
        return any(one.topic == topic for node in _NODES for one in node.subscriptions)

    def publish(self, topic, kind, message):
        if not any(one.topic == topic for one in self.node.publishers):
            self.advertise(topic, kind)
        (publisher,) = [one for one in self.node.publishers if one.topic == topic]
        publisher.publish(to_object(self.types, kind, message))

    def close(self):
        self.node.destroy_node()


def _with_texts(request):
    """Write the identifier of a goal as rosbridge does."""
    if "goal_info" in request:
        uuid = request["goal_info"]["goal_id"]["uuid"]
        request["goal_info"]["goal_id"]["uuid"] = b64encode(bytes(uuid)).decode()
    return request


def _message(kind):
    assert hasattr(kind, "get_fields_and_field_types"), f"{kind} is no class of a message"
    return kind


def _service(kind):
    assert hasattr(kind, "Request"), f"{kind} is no class of a service"
    return kind


def _name(name):
    assert name.startswith("/"), f"{name} would be in the node's namespace"
    return name


def _quality(qos_profile):
    assert isinstance(qos_profile, QoSProfile | int)
    return qos_profile


def get_message(identifier):
    package, folder, name = (
        identifier.split("/") if identifier.count("/") == 2 else (None, None, None)
    )
    if package is None:
        raise ValueError(f"Expected the full name of a message, got '{identifier}'")
    if f"{package}/{folder}/{name}" not in ros.types().store.fielddefs:
        raise ModuleNotFoundError(f"No module named '{package}'")
    return _class(identifier)


def get_service(identifier):
    if identifier.count("/") != 2:
        raise ValueError(f"Expected the full name of a service, got '{identifier}'")
    if f"{identifier}_Request" not in ros.types().store.fielddefs:
        raise ModuleNotFoundError(f"No module named '{identifier.split('/')[0]}'")
    if identifier not in _CLASSES:
        halves = {half: _class(f"{identifier}_{half}") for half in ("Request", "Response")}
        _CLASSES[identifier] = type(identifier.split("/")[-1], (), halves)
    return _CLASSES[identifier]


def get_action(identifier):
    if f"{identifier}_Goal" not in ros.types().store.fielddefs:
        raise ModuleNotFoundError(f"No module named '{identifier.split('/')[0]}'")
    parts = {part: _class(f"{identifier}_{part}") for part in ("Goal", "Feedback", "Result")}
    return type(identifier.split("/")[-1], (), {"name": identifier, **parts})


def _class(kind):
    """Return the class of a message as rosidl generates it, with checked setters."""
    if kind not in _CLASSES:
        fields = {
            name: (node.name, what)
            for name, (node, what) in ros.types().store.fielddefs[kind][1]
            if name != "structure_needs_at_least_one_member"
        }
        _CLASSES[kind] = type(
            kind.split("/")[-1], (_Message,), {"_fields": fields, "__slots__": tuple(fields)}
        )
    return _CLASSES[kind]


def _said(node, what):
    if node == "BASE":
        name, limit = what
        return f"{_IDL.get(name, name)}<{limit}>" if limit else _IDL.get(name, name)
    if node == "NAME":
        return what.replace("/msg/", "/")
    (inner, of), length = what
    one = _said(inner.name, of)
    return (
        f"{one}[{length}]"
        if node == "ARRAY"
        else f"sequence<{one}, {length}>"
        if length
        else f"sequence<{one}>"
    )


def _empty(node, what):
    if node == "NAME":
        return _class(what)()
    if node == "BASE":
        return {"bool": False, "byte": b"\x00", "float32": 0.0, "float64": 0.0, "string": ""}.get(
            what[0], 0
        )
    (inner, of), length = what
    return [_empty(inner.name, of) for _ in range(length)] if node == "ARRAY" else []


def _check(node, what, value):
    if node == "NAME":
        assert type(value) is _class(what), f"must be a sub message of type {what}"
    elif node == "BASE":
        name = what[0]
        wanted = {
            "bool": bool,
            "byte": bytes,
            "float32": float,
            "float64": float,
            "string": str,
        }.get(name, int)
        assert isinstance(value, wanted), f"must be of type {wanted}, not {value!r}"
        assert name != "byte" or len(value) == 1, "must be bytes of length 1"
    else:
        (inner, of), length = what
        assert isinstance(value, list), "must be a sequence"
        assert node != "ARRAY" or len(value) == length
        for one in value:
            _check(inner.name, of, one)


class _Message:
    __slots__ = ()

    def __init__(self, **kwargs):
        unknown = set(kwargs) - set(self._fields)
        assert not unknown, f"Invalid arguments passed to constructor: {unknown}"
        for name, field in self._fields.items():
            setattr(self, name, kwargs.get(name, _empty(*field)))

    def __setattr__(self, name, value):
        _check(*self._fields[name], value)
        object.__setattr__(self, name, value)

    @classmethod
    def get_fields_and_field_types(cls):
        return {name: _said(*field) for name, field in cls._fields.items()}


_TYPES = {
    "action_msgs/srv/CancelGoal_Request": "action_msgs/GoalInfo goal_info",
    "action_msgs/srv/CancelGoal_Response": "int8 return_code\naction_msgs/GoalInfo[] goals_canceling",
    "nav2_msgs/action/NavigateToPose_Goal": "geometry_msgs/PoseStamped pose\nstring behavior_tree",
    "nav2_msgs/action/NavigateToPose_Result": "uint16 error_code\nstring error_msg",
    "nav2_msgs/action/NavigateToPose_Feedback": "geometry_msgs/PoseStamped current_pose\nint16 number_of_recoveries\n"
    "float32 distance_remaining",
}
"""Types that `rosbags` does not have; of NavigateToPose, the fields that are used."""


def _register():
    from rosbags.typesys import get_types_from_msg

    store = ros.types().store
    for kind, text in _TYPES.items():
        if kind not in store.fielddefs:
            (found,) = get_types_from_msg(text, "x/msg/X").values()
            store.register({kind: found})


@contextmanager
def installed():
    """Have them imported as if ROS 2 were there."""
    parts = {
        "rclpy": {"init": init, "shutdown": shutdown, "create_node": create_node},
        "rclpy.context": {"Context": Context},
        "rclpy.action": {"ActionClient": ActionClient},
        "rclpy.qos": {
            "QoSProfile": QoSProfile,
            "ReliabilityPolicy": ReliabilityPolicy,
            "DurabilityPolicy": DurabilityPolicy,
        },
        "rclpy.executors": {
            "SingleThreadedExecutor": SingleThreadedExecutor,
            "ExternalShutdownException": ExternalShutdownException,
            "ShutdownException": ShutdownException,
        },
        "rosidl_runtime_py": {},
        "rosidl_runtime_py.utilities": {
            "get_message": get_message,
            "get_service": get_service,
            "get_action": get_action,
        },
    }
    _register()
    for name, content in parts.items():
        module = sys.modules[name] = ModuleType(name)
        vars(module).update(content)
        module.__path__ = []
    try:
        yield
    finally:
        for name in parts:
            del sys.modules[name]
