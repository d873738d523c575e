from google.protobuf import wrappers_pb2 as _wrappers_pb2
from slamcu_core.sensoris.proto import base_pb2 as _base_pb2
from google.protobuf.internal import containers as _containers
from google.protobuf import descriptor as _descriptor
from google.protobuf import message as _message
from collections.abc import Iterable as _Iterable, Mapping as _Mapping
from typing import ClassVar as _ClassVar, Optional as _Optional, Union as _Union

DESCRIPTOR: _descriptor.FileDescriptor

class JobIds(_message.Message):
    __slots__ = ("submitter", "job_id", "vehicle_fleet_id", "vehicle_id", "driver_id")
    SUBMITTER_FIELD_NUMBER: _ClassVar[int]
    JOB_ID_FIELD_NUMBER: _ClassVar[int]
    VEHICLE_FLEET_ID_FIELD_NUMBER: _ClassVar[int]
    VEHICLE_ID_FIELD_NUMBER: _ClassVar[int]
    DRIVER_ID_FIELD_NUMBER: _ClassVar[int]
    submitter: _containers.RepeatedCompositeFieldContainer[_base_pb2.Entity]
    job_id: _containers.RepeatedCompositeFieldContainer[_wrappers_pb2.StringValue]
    vehicle_fleet_id: _containers.RepeatedCompositeFieldContainer[_wrappers_pb2.StringValue]
    vehicle_id: _containers.RepeatedCompositeFieldContainer[_wrappers_pb2.StringValue]
    driver_id: _containers.RepeatedCompositeFieldContainer[_wrappers_pb2.StringValue]
    def __init__(self, submitter: _Optional[_Iterable[_Union[_base_pb2.Entity, _Mapping]]] = ..., job_id: _Optional[_Iterable[_Union[_wrappers_pb2.StringValue, _Mapping]]] = ..., vehicle_fleet_id: _Optional[_Iterable[_Union[_wrappers_pb2.StringValue, _Mapping]]] = ..., vehicle_id: _Optional[_Iterable[_Union[_wrappers_pb2.StringValue, _Mapping]]] = ..., driver_id: _Optional[_Iterable[_Union[_wrappers_pb2.StringValue, _Mapping]]] = ...) -> None: ...
