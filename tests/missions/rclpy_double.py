"""rclpy and message packages, as far as the product uses them.

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
from functools import cache
from queue import Empty, Queue
from threading import RLock
from types import ModuleType, SimpleNamespace
from typing import ClassVar

from missions.wires import ros
from missions.wires.rclpy import Messages
from missions.wires.ros import to_message

_LOCK = RLock()
_NODES = []


class ReliabilityPolicy(IntEnum):
    RELIABLE = 1
    BEST_EFFORT = 2


class DurabilityPolicy(IntEnum):
    TRANSIENT_LOCAL = 1
    VOLATILE = 2


class QoSProfile:
    def __init__(
        self,
        *,
        depth,
        reliability=ReliabilityPolicy.RELIABLE,
        durability=DurabilityPolicy.VOLATILE,
    ):
        self.reliability = reliability
        self.durability = durability

    def __eq__(self, other):
        return vars(self) == vars(other)

    def serves(self, asked):
        """Return whether a subscription with another profile hears a publisher with this one."""
        return self.reliability <= asked.reliability and self.durability <= asked.durability


class ExternalShutdownException(Exception): ...


class ShutdownException(Exception): ...


class Context:
    is_open = False


def init(*, context=None):
    assert not context.is_open, "Context.init() must only be called once"
    context.is_open = True


def shutdown(*, context=None):
    assert context.is_open, "Cannot shutdown a ROS adapter that is not running"
    context.is_open = False


def create_node(node_name, *, context=None):
    assert context.is_open, "the given context is not valid"
    return Node()


class Future:
    def __init__(self):
        self._is_done = False
        self._result = None
        self._callbacks = []

    def result(self):
        return self._result

    def exception(self):
        return None

    def add_done_callback(self, callback):
        if self._is_done:
            callback(self)
        self._callbacks.append(callback)

    def set_result(self, result):
        self._is_done = True
        self._result = result
        for callback in self._callbacks:
            callback(self)


class Publisher:
    def __init__(self, msg_type, topic, qos_profile):
        self.msg_type = msg_type
        self.topic = topic
        self.qos_profile = qos_profile
        self.last = None

    def publish(self, msg):
        assert isinstance(msg, self.msg_type), f"Expected {self.msg_type}, got {type(msg)}"
        with _LOCK:
            self.last = msg
            for node in _NODES:
                for hearer in node.subscriptions:
                    if hearer.topic == self.topic and self.qos_profile.serves(hearer.qos_profile):
                        assert hearer.msg_type is self.msg_type
                        node.todo.put(lambda hearer=hearer: hearer.callback(msg))


class Client:
    def __init__(self, node, srv_type, srv_name):
        self.node = node
        self.srv_type = srv_type
        self.srv_name = srv_name

    def _servers(self):
        with _LOCK:
            services = [(node, service) for node in _NODES for service in node.services]
        return [pair for pair in services if pair[1].srv_name == self.srv_name]

    def service_is_ready(self):
        return bool(self._servers())

    def call_async(self, request):
        if not isinstance(request, self.srv_type.Request):
            raise TypeError
        future = Future()
        (node, service) = self._servers()[0]

        def serve():
            response = service.callback(request, service.srv_type.Response())
            if response is not None:
                assert isinstance(response, service.srv_type.Response)
                self.node.todo.put(lambda: future.set_result(response))

        serve() if node.is_robot else node.todo.put(serve)
        return future


class ActionClient:
    def __init__(self, node, action_type, action_name):
        self.node = node
        self.type = action_type
        self.name = action_name

    def send_goal_async(self, goal, feedback_callback=None):
        assert isinstance(goal, self.type.Goal)
        response = Future()
        result = Future()
        todo = self.node.todo
        server = RobotHost.actions.get(self.name)

        def show(values):
            message = SimpleNamespace(feedback=_filled(self.type.Feedback, values))
            todo.put(lambda: feedback_callback(message))

        def end(status, values):
            answer = SimpleNamespace(status=status, result=_filled(self.type.Result, values))
            todo.put(lambda: result.set_result(answer))

        key = None if server is None else server.begin(to_message(goal), show, end)
        if key is not None:  # else it never completes, even if a server comes later
            handle = GoalHandle(self.node, server, key, result)
            todo.put(lambda: response.set_result(handle))
        return response


class GoalHandle:
    status = 0

    def __init__(self, node, server, key, result):
        self.node = node
        self.server = server
        self.key = key
        self.accepted = bool(key)
        self.get_result_async = lambda: result

    def cancel_goal_async(self):
        answered = Future()
        is_cancelling = self.server.cancel(self.key)
        if is_cancelling is not None:
            goals = [self.key] if is_cancelling else []
            answer = SimpleNamespace(return_code=0, goals_canceling=goals)
            self.node.todo.put(lambda: answered.set_result(answer))
        return answered


class Node:
    is_robot = False

    def __init__(self):
        self.todo = Queue()
        self.subscriptions = []
        self.publishers = []
        self.services = []
        self.timers = []
        with _LOCK:
            _NODES.append(self)

    def create_publisher(self, msg_type, topic, qos_profile):
        publisher = Publisher(_message(msg_type), _name(topic), _quality(qos_profile))
        self.publishers.append(publisher)
        return publisher

    def create_subscription(self, msg_type, topic, callback, qos_profile):
        made = SimpleNamespace(msg_type=_message(msg_type), topic=_name(topic), callback=callback)
        made.qos_profile = _quality(qos_profile)
        is_latched = qos_profile.durability == DurabilityPolicy.TRANSIENT_LOCAL
        with _LOCK:
            self.subscriptions.append(made)
            for publisher in _publishers(topic):
                is_heard = is_latched and publisher.qos_profile.serves(qos_profile)
                if is_heard and publisher.last is not None:
                    self.todo.put(lambda last=publisher.last: callback(last))
        return made

    def destroy_subscription(self, subscription):
        with _LOCK:
            self.subscriptions.remove(subscription)

    def create_client(self, srv_type, srv_name):
        return Client(self, _service(srv_type), _name(srv_name))

    def create_service(self, srv_type, srv_name, callback):
        service = SimpleNamespace(srv_type=_service(srv_type), srv_name=_name(srv_name))
        service.callback = callback
        with _LOCK:
            self.services.append(service)

    def create_timer(self, timer_period_sec, callback):
        self.timers.append((float(timer_period_sec), callback))

    def get_publishers_info_by_topic(self, topic_name):
        with _LOCK:
            return _publishers(topic_name)

    def destroy_node(self):
        with _LOCK:
            _NODES.remove(self)


class SingleThreadedExecutor:
    def __init__(self, *, context=None):
        assert context.is_open
        self.context = context
        self.node = None
        self.is_shut = False

    def add_node(self, node):
        self.node = node

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


class RobotHost:
    """Carries a robot of `ros_robot`; it answers at once, and needs no thread."""

    actions: ClassVar = {}

    def __init__(self):
        self.types = Messages()
        self.node = Node()
        self.actions = RobotHost.actions
        self.node.is_robot = True
        self.actions.clear()

    def serve(self, service, kind, answer):
        def respond(request, _):
            values = answer(_with_texts(to_message(request)))
            return None if values is None else self.types.to_object(f"{kind}_Response", values)

        self.unserve(service)
        self.node.create_service(self.types.find(kind), service, respond)

    def unserve(self, service):
        self.node.services = [s for s in self.node.services if s.srv_name != service]

    def advertise(self, topic, kind, *, is_latched=False):
        durability = DurabilityPolicy.TRANSIENT_LOCAL if is_latched else DurabilityPolicy.VOLATILE
        self.unadvertise(topic)
        quality = QoSProfile(depth=10, durability=durability)
        self.node.create_publisher(self.types.find(kind), topic, quality)

    def unadvertise(self, topic):
        self.node.publishers = [
            publisher for publisher in self.node.publishers if publisher.topic != topic
        ]

    def has_hearer(self, topic):
        return any(
            subscription.topic == topic for node in _NODES for subscription in node.subscriptions
        )

    def publish(self, topic, kind, message):
        if not any(publisher.topic == topic for publisher in self.node.publishers):
            self.advertise(topic, kind)
        (publisher,) = [publisher for publisher in self.node.publishers if publisher.topic == topic]
        publisher.publish(self.types.to_object(kind, message))

    def close(self):
        self.node.destroy_node()


def _with_texts(request):
    """Write the identifier of a goal as rosbridge does."""
    if "goal_info" in request:
        uuid = request["goal_info"]["goal_id"]["uuid"]
        request["goal_info"]["goal_id"]["uuid"] = b64encode(bytes(uuid)).decode()
    return request


def _publishers(topic):
    return [
        publisher for node in _NODES for publisher in node.publishers if publisher.topic == topic
    ]


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
    return QoSProfile(depth=qos_profile) if isinstance(qos_profile, int) else qos_profile


# ------------------------------------------------------------ message packages

_IDL = {"bool": "boolean", "byte": "octet", "float32": "float", "float64": "double"}
_EMPTY = {"bool": False, "byte": b"\x00", "float32": 0.0, "float64": 0.0, "string": ""}
"""The values of new messages, whose types are those that the setters take; others are 0."""
_TYPES = {
    "action_msgs/srv/CancelGoal_Request": "action_msgs/GoalInfo goal_info",
    "action_msgs/srv/CancelGoal_Response": "int8 return_code\n"
    "action_msgs/GoalInfo[] goals_canceling",
    "nav2_msgs/action/NavigateToPose_Goal": "geometry_msgs/PoseStamped pose\nstring behavior_tree",
    "nav2_msgs/action/NavigateToPose_Result": "uint16 error_code\nstring error_msg",
    "nav2_msgs/action/NavigateToPose_Feedback": "geometry_msgs/PoseStamped current_pose\n"
    "int16 number_of_recoveries\n"
    "float32 distance_remaining",
}
"""Types that `rosbags` does not have; of NavigateToPose, the fields that are used."""
_PARTS = {"srv": ("Request", "Response"), "action": ("Goal", "Feedback", "Result")}


class _Message:
    """A message with checked setters, as rosidl generates them."""

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
        return {name: _written(*field) for name, field in cls._fields.items()}


@cache
def _class(kind):
    if kind not in ros.types().store.fielddefs:
        raise AttributeError(f"no {kind}")
    definition = ros.types().store.fielddefs[kind][1]
    fields = {name: (node.name, what) for name, (node, what) in definition if name != ros.NOTHING}
    content = {"_fields": fields, "__slots__": tuple(fields)}
    return type(kind.split("/")[-1], (_Message,), content)


@cache
def _of_package(package, folder, name):
    if name.startswith("__"):
        raise AttributeError(name)
    kind = f"{package}/{folder}/{name}"
    if folder == "msg":
        return _class(kind)
    return type(name, (), {part: _class(f"{kind}_{part}") for part in _PARTS[folder]})


def _filled(kind, values):
    return kind(**values)


def _written(node, what):
    if node == "NAME":
        return what.replace("/msg/", "/")
    if node == "BASE":
        name, limit = what
        return f"{_IDL.get(name, name)}<{limit}>" if limit else _IDL.get(name, name)
    (inner, of), length = what
    item = _written(inner.name, of)
    if node == "ARRAY":
        return f"{item}[{length}]"
    return f"sequence<{item}, {length}>" if length else f"sequence<{item}>"


def _empty(node, what):
    if node == "NAME":
        return _class(what)()
    if node == "BASE":
        return _EMPTY.get(what[0], 0)
    (inner, of), length = what
    return [_empty(inner.name, of) for _ in range(length)] if node == "ARRAY" else []


def _check(node, what, value):
    if node in ("NAME", "BASE"):
        kind = type(_empty(node, what))
        assert isinstance(value, kind), f"must be of type {kind}, not {value!r}"
        return
    (inner, of), length = what
    assert isinstance(value, list), "must be a sequence"
    assert node != "ARRAY" or len(value) == length
    for item in value:
        _check(inner.name, of, item)


def _register():
    from rosbags.typesys import get_types_from_msg

    store = ros.types().store
    for kind, text in _TYPES.items():
        if kind not in store.fielddefs:
            (definition,) = get_types_from_msg(text, "x/msg/X").values()
            store.register({kind: definition})


def _modules():
    """Yield the modules of rclpy and of the message packages: name and content."""
    yield "rclpy", {"init": init, "shutdown": shutdown, "create_node": create_node}
    for name, contents in {
        "context": (Context,),
        "action": (ActionClient,),
        "qos": (QoSProfile, ReliabilityPolicy, DurabilityPolicy),
        "executors": (SingleThreadedExecutor, ExternalShutdownException, ShutdownException),
    }.items():
        yield f"rclpy.{name}", {content.__name__: content for content in contents}
    for package, folder in {tuple(kind.split("/")[:2]) for kind in ros.types().store.fielddefs}:
        yield package, {}
        content = {"__getattr__": lambda name, p=package, f=folder: _of_package(p, f, name)}
        yield f"{package}.{folder}", content


@contextmanager
def installed():
    """Have them imported as if ROS 2 were there."""
    _register()
    modules = dict(_modules())
    for name, content in modules.items():
        module = sys.modules[name] = ModuleType(name)
        vars(module).update({"__path__": [], **content})
    try:
        yield
    finally:
        for name in modules:
            del sys.modules[name]
