"""The rover's ROS 2 side over DDS, with nothing of ours: types of cyclonedds written by hand, as ROS 2 has them.

`python dds_rover.py`; lines of input are what to publish from then on (`battery 0.1`), lines of output what happens.
"""

import sys
from dataclasses import dataclass
from itertools import chain
from queue import Empty, Queue
from threading import Thread

from cyclonedds.core import Policy, Qos
from cyclonedds.domain import DomainParticipant
from cyclonedds.idl import IdlStruct
from cyclonedds.idl.types import float32, float64, int32, int64, sequence, uint8, uint32, uint64
from cyclonedds.pub import DataWriter
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from cyclonedds.util import duration


@dataclass
class Time(IdlStruct, typename="builtin_interfaces.msg.dds_.Time_"):
    sec: int32 = 0
    nanosec: uint32 = 0


@dataclass
class Header(IdlStruct, typename="std_msgs.msg.dds_.Header_"):
    stamp: Time
    frame_id: str = ""


@dataclass
class BatteryState(IdlStruct, typename="sensor_msgs.msg.dds_.BatteryState_"):
    header: Header
    voltage: float32
    temperature: float32
    current: float32
    charge: float32
    capacity: float32
    design_capacity: float32
    percentage: float32
    power_supply_status: uint8
    power_supply_health: uint8
    power_supply_technology: uint8
    present: bool
    cell_voltage: sequence[float32]
    cell_temperature: sequence[float32]
    location: str
    serial_number: str


@dataclass
class Illuminance(IdlStruct, typename="sensor_msgs.msg.dds_.Illuminance_"):
    header: Header
    illuminance: float64
    variance: float64


@dataclass
class KeyValue(IdlStruct, typename="diagnostic_msgs.msg.dds_.KeyValue_"):
    key: str
    value: str


@dataclass
class DiagnosticStatus(IdlStruct, typename="diagnostic_msgs.msg.dds_.DiagnosticStatus_"):
    level: uint8
    name: str
    message: str
    hardware_id: str
    values: sequence[KeyValue]


@dataclass
class DiagnosticArray(IdlStruct, typename="diagnostic_msgs.msg.dds_.DiagnosticArray_"):
    header: Header
    status: sequence[DiagnosticStatus]


@dataclass
class String(IdlStruct, typename="std_msgs.msg.dds_.String_"):
    data: str


@dataclass
class State(IdlStruct, typename="lifecycle_msgs.msg.dds_.State_"):
    id: uint8
    label: str = ""


@dataclass
class Transition(IdlStruct, typename="lifecycle_msgs.msg.dds_.Transition_"):
    id: uint8
    label: str = ""


@dataclass
class GetStateRequest(IdlStruct, typename="lifecycle_msgs.srv.dds_.GetState_Request_"):
    rmw_guid: uint64
    rmw_seq: int64
    structure_needs_at_least_one_member: uint8


@dataclass
class GetStateResponse(IdlStruct, typename="lifecycle_msgs.srv.dds_.GetState_Response_"):
    rmw_guid: uint64
    rmw_seq: int64
    current_state: State


@dataclass
class ChangeStateRequest(IdlStruct, typename="lifecycle_msgs.srv.dds_.ChangeState_Request_"):
    rmw_guid: uint64
    rmw_seq: int64
    transition: Transition


@dataclass
class ChangeStateResponse(IdlStruct, typename="lifecycle_msgs.srv.dds_.ChangeState_Response_"):
    rmw_guid: uint64
    rmw_seq: int64
    success: bool


@dataclass
class ParameterValue(IdlStruct, typename="rcl_interfaces.msg.dds_.ParameterValue_"):
    type: uint8
    bool_value: bool
    integer_value: int64
    double_value: float64
    string_value: str
    byte_array_value: sequence[uint8]
    bool_array_value: sequence[bool]
    integer_array_value: sequence[int64]
    double_array_value: sequence[float64]
    string_array_value: sequence[str]


@dataclass
class Parameter(IdlStruct, typename="rcl_interfaces.msg.dds_.Parameter_"):
    name: str
    value: ParameterValue


@dataclass
class Result(IdlStruct, typename="rcl_interfaces.msg.dds_.SetParametersResult_"):
    successful: bool
    reason: str


@dataclass
class SetRequest(IdlStruct, typename="rcl_interfaces.srv.dds_.SetParametersAtomically_Request_"):
    rmw_guid: uint64
    rmw_seq: int64
    parameters: sequence[Parameter]


@dataclass
class SetResponse(IdlStruct, typename="rcl_interfaces.srv.dds_.SetParametersAtomically_Response_"):
    rmw_guid: uint64
    rmw_seq: int64
    result: Result


RELIABLE = Qos(Policy.Reliability.Reliable(duration(seconds=1)), Policy.History.KeepLast(10))
LOSSY = Qos(
    Policy.Reliability.BestEffort, Policy.History.KeepLast(10)
)  # as sensors of ROS 2 publish


class Rover:
    def __init__(self):
        self.participant = DomainParticipant()
        self.states = dict.fromkeys(("/front/camera", "/lidar", "/navigator"), 1)
        self.services = []
        for node in self.states:
            self.serve(
                f"{node}/get_state",
                GetStateRequest,
                GetStateResponse,
                lambda _, n=node: State(self.states[n]),
            )
            self.serve(
                f"{node}/change_state",
                ChangeStateRequest,
                ChangeStateResponse,
                lambda one, n=node: self.change(n, one),
            )
            self.serve(
                f"{node}/set_parameters_atomically",
                SetRequest,
                SetResponse,
                lambda one, n=node: self.set(n, one),
            )
        self.events = DataReader(
            self.participant, Topic(self.participant, "rt/rosa_kb/events", String), qos=RELIABLE
        )
        self.battery = self.writer("rt/battery_state", BatteryState, LOSSY)
        self.light = self.writer("rt/light_sensor", Illuminance, LOSSY)
        self.diagnostics = self.writer("rt/diagnostics", DiagnosticArray, RELIABLE)

    def writer(self, name, kind, quality):
        return DataWriter(self.participant, Topic(self.participant, name, kind), qos=quality)

    def serve(self, name, request, response, answer):
        reader = DataReader(
            self.participant, Topic(self.participant, f"rq{name}Request", request), qos=RELIABLE
        )
        self.services.append(
            (reader, self.writer(f"rr{name}Reply", response, RELIABLE), response, answer)
        )

    def change(self, node, request):
        goal = {(1, 1): 2, (2, 3): 3, (3, 4): 2}.get((self.states[node], request.transition.id))
        self.states[node] = goal or self.states[node]
        print(f"{node} {self.states[node]}", flush=True)
        return goal is not None

    def set(self, node, request):
        for one in request.parameters:
            print(f"{node} {one.name} {one.value.double_value}", flush=True)
        return Result(True, "")

    def turn(self, battery, light, failed):
        for reader, writer, response, answer in self.services:
            for request in reader.take(10):
                if request.sample_info.valid_data:
                    writer.write(response(request.rmw_guid, request.rmw_seq, answer(request)))
        for event in self.events.take(100):
            if event.sample_info.valid_data:
                print(event.data, flush=True)
        header = Header(Time())
        cells = [float("nan")] * 3
        self.battery.write(
            BatteryState(header, 12.0, 20.0, 0, 0, 0, 0, battery, 0, 0, 0, True, cells, [], "", "")
        )
        self.light.write(Illuminance(header, light, 0.0))
        values = [KeyValue(name, "failure") for name in failed]
        status = DiagnosticStatus(2, "watchdog", "Component status", "", values)
        self.diagnostics.write(DiagnosticArray(header, [status]))


def main():
    rover, lines, said = Rover(), Queue(), {"battery": 0.9, "light": 0.9, "failed": []}
    Thread(
        target=lambda: [lines.put(line) for line in chain(sys.stdin, ["end"])], daemon=True
    ).start()
    while True:
        try:
            name, _, value = lines.get(timeout=0.05).strip().partition(" ")
            if name == "end":
                return
            said[name] = [value] if name == "failed" else float(value)
        except Empty:
            rover.turn(**said)


if __name__ == "__main__":
    main()
