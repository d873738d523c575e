from google.protobuf import any_pb2 as _any_pb2
from google.protobuf import wrappers_pb2 as _wrappers_pb2
from slamcu_core.sensoris.proto import base_pb2 as _base_pb2
from slamcu_core.sensoris.proto import intersection_attribution_pb2 as _intersection_attribution_pb2
from slamcu_core.sensoris.proto import job_pb2 as _job_pb2
from slamcu_core.sensoris.proto import localization_pb2 as _localization_pb2
from slamcu_core.sensoris.proto import map_pb2 as _map_pb2
from slamcu_core.sensoris.proto import object_detection_pb2 as _object_detection_pb2
from slamcu_core.sensoris.proto import source_pb2 as _source_pb2
from slamcu_core.sensoris.proto import spatial_pb2 as _spatial_pb2
from slamcu_core.sensoris.proto import traffic_regulation_pb2 as _traffic_regulation_pb2
from google.protobuf.internal import containers as _containers
from google.protobuf.internal import enum_type_wrapper as _enum_type_wrapper
from google.protobuf import descriptor as _descriptor
from google.protobuf import message as _message
from collections.abc import Iterable as _Iterable, Mapping as _Mapping
from typing import ClassVar as _ClassVar, Optional as _Optional, Union as _Union

DESCRIPTOR: _descriptor.FileDescriptor

class EventGroup(_message.Message):
    __slots__ = ("envelope", "localization_category", "object_detection_category", "intersection_attribution_category", "traffic_regulation_category", "map_category")
    class Envelope(_message.Message):
        __slots__ = ("origin", "extension")
        class Origin(_message.Message):
            __slots__ = ("timestamp", "position_and_accuracy", "orientation_and_accuracy")
            TIMESTAMP_FIELD_NUMBER: _ClassVar[int]
            POSITION_AND_ACCURACY_FIELD_NUMBER: _ClassVar[int]
            ORIENTATION_AND_ACCURACY_FIELD_NUMBER: _ClassVar[int]
            timestamp: _base_pb2.Timestamp
            position_and_accuracy: _spatial_pb2.PositionAndAccuracy
            orientation_and_accuracy: _spatial_pb2.RotationAndAccuracy
            def __init__(self, timestamp: _Optional[_Union[_base_pb2.Timestamp, _Mapping]] = ..., position_and_accuracy: _Optional[_Union[_spatial_pb2.PositionAndAccuracy, _Mapping]] = ..., orientation_and_accuracy: _Optional[_Union[_spatial_pb2.RotationAndAccuracy, _Mapping]] = ...) -> None: ...
        ORIGIN_FIELD_NUMBER: _ClassVar[int]
        EXTENSION_FIELD_NUMBER: _ClassVar[int]
        origin: EventGroup.Envelope.Origin
        extension: _containers.RepeatedCompositeFieldContainer[_any_pb2.Any]
        def __init__(self, origin: _Optional[_Union[EventGroup.Envelope.Origin, _Mapping]] = ..., extension: _Optional[_Iterable[_Union[_any_pb2.Any, _Mapping]]] = ...) -> None: ...
    ENVELOPE_FIELD_NUMBER: _ClassVar[int]
    LOCALIZATION_CATEGORY_FIELD_NUMBER: _ClassVar[int]
    OBJECT_DETECTION_CATEGORY_FIELD_NUMBER: _ClassVar[int]
    INTERSECTION_ATTRIBUTION_CATEGORY_FIELD_NUMBER: _ClassVar[int]
    TRAFFIC_REGULATION_CATEGORY_FIELD_NUMBER: _ClassVar[int]
    MAP_CATEGORY_FIELD_NUMBER: _ClassVar[int]
    envelope: EventGroup.Envelope
    localization_category: _localization_pb2.LocalizationCategory
    object_detection_category: _object_detection_pb2.ObjectDetectionCategory
    intersection_attribution_category: _intersection_attribution_pb2.IntersectionAttributionCategory
    traffic_regulation_category: _traffic_regulation_pb2.TrafficRegulationCategory
    map_category: _map_pb2.MapCategory
    def __init__(self, envelope: _Optional[_Union[EventGroup.Envelope, _Mapping]] = ..., localization_category: _Optional[_Union[_localization_pb2.LocalizationCategory, _Mapping]] = ..., object_detection_category: _Optional[_Union[_object_detection_pb2.ObjectDetectionCategory, _Mapping]] = ..., intersection_attribution_category: _Optional[_Union[_intersection_attribution_pb2.IntersectionAttributionCategory, _Mapping]] = ..., traffic_regulation_category: _Optional[_Union[_traffic_regulation_pb2.TrafficRegulationCategory, _Mapping]] = ..., map_category: _Optional[_Union[_map_pb2.MapCategory, _Mapping]] = ...) -> None: ...

class DataMessage(_message.Message):
    __slots__ = ("envelope", "event_group", "event_relation", "event_source")
    class AbsolutePaths(_message.Message):
        __slots__ = ("path",)
        class Path(_message.Message):
            __slots__ = ("field_number",)
            FIELD_NUMBER_FIELD_NUMBER: _ClassVar[int]
            field_number: _containers.RepeatedScalarFieldContainer[int]
            def __init__(self, field_number: _Optional[_Iterable[int]] = ...) -> None: ...
        PATH_FIELD_NUMBER: _ClassVar[int]
        path: _containers.RepeatedCompositeFieldContainer[DataMessage.AbsolutePaths.Path]
        def __init__(self, path: _Optional[_Iterable[_Union[DataMessage.AbsolutePaths.Path, _Mapping]]] = ...) -> None: ...
    class Paths(_message.Message):
        __slots__ = ("absolute_paths",)
        ABSOLUTE_PATHS_FIELD_NUMBER: _ClassVar[int]
        absolute_paths: DataMessage.AbsolutePaths
        def __init__(self, absolute_paths: _Optional[_Union[DataMessage.AbsolutePaths, _Mapping]] = ...) -> None: ...
    class Envelope(_message.Message):
        __slots__ = ("ids", "job_ids", "field_resolution_override", "map_identification", "extension")
        class Ids(_message.Message):
            __slots__ = ("session_id", "message_id", "last_message_of_session", "vehicle_fleet_id", "vehicle_id", "driver_id")
            SESSION_ID_FIELD_NUMBER: _ClassVar[int]
            MESSAGE_ID_FIELD_NUMBER: _ClassVar[int]
            LAST_MESSAGE_OF_SESSION_FIELD_NUMBER: _ClassVar[int]
            VEHICLE_FLEET_ID_FIELD_NUMBER: _ClassVar[int]
            VEHICLE_ID_FIELD_NUMBER: _ClassVar[int]
            DRIVER_ID_FIELD_NUMBER: _ClassVar[int]
            session_id: _wrappers_pb2.StringValue
            message_id: _wrappers_pb2.Int64Value
            last_message_of_session: _wrappers_pb2.BoolValue
            vehicle_fleet_id: _wrappers_pb2.StringValue
            vehicle_id: _wrappers_pb2.StringValue
            driver_id: _wrappers_pb2.StringValue
            def __init__(self, session_id: _Optional[_Union[_wrappers_pb2.StringValue, _Mapping]] = ..., message_id: _Optional[_Union[_wrappers_pb2.Int64Value, _Mapping]] = ..., last_message_of_session: _Optional[_Union[_wrappers_pb2.BoolValue, _Mapping]] = ..., vehicle_fleet_id: _Optional[_Union[_wrappers_pb2.StringValue, _Mapping]] = ..., vehicle_id: _Optional[_Union[_wrappers_pb2.StringValue, _Mapping]] = ..., driver_id: _Optional[_Union[_wrappers_pb2.StringValue, _Mapping]] = ...) -> None: ...
        class FieldResolutionOverride(_message.Message):
            __slots__ = ("paths", "exponent")
            PATHS_FIELD_NUMBER: _ClassVar[int]
            EXPONENT_FIELD_NUMBER: _ClassVar[int]
            paths: DataMessage.Paths
            exponent: _wrappers_pb2.Int64Value
            def __init__(self, paths: _Optional[_Union[DataMessage.Paths, _Mapping]] = ..., exponent: _Optional[_Union[_wrappers_pb2.Int64Value, _Mapping]] = ...) -> None: ...
        class MapIdentification(_message.Message):
            __slots__ = ("provider_version", "compiler_version", "format")
            class Format(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
                __slots__ = ()
                UNKNOWN_FORMAT: _ClassVar[DataMessage.Envelope.MapIdentification.Format]
                OTHER: _ClassVar[DataMessage.Envelope.MapIdentification.Format]
                NDS: _ClassVar[DataMessage.Envelope.MapIdentification.Format]
            UNKNOWN_FORMAT: DataMessage.Envelope.MapIdentification.Format
            OTHER: DataMessage.Envelope.MapIdentification.Format
            NDS: DataMessage.Envelope.MapIdentification.Format
            class MapVersion(_message.Message):
                __slots__ = ("source", "version", "extraction_timestamp")
                SOURCE_FIELD_NUMBER: _ClassVar[int]
                VERSION_FIELD_NUMBER: _ClassVar[int]
                EXTRACTION_TIMESTAMP_FIELD_NUMBER: _ClassVar[int]
                source: _wrappers_pb2.StringValue
                version: _base_pb2.Version
                extraction_timestamp: _base_pb2.Timestamp
                def __init__(self, source: _Optional[_Union[_wrappers_pb2.StringValue, _Mapping]] = ..., version: _Optional[_Union[_base_pb2.Version, _Mapping]] = ..., extraction_timestamp: _Optional[_Union[_base_pb2.Timestamp, _Mapping]] = ...) -> None: ...
            PROVIDER_VERSION_FIELD_NUMBER: _ClassVar[int]
            COMPILER_VERSION_FIELD_NUMBER: _ClassVar[int]
            FORMAT_FIELD_NUMBER: _ClassVar[int]
            provider_version: DataMessage.Envelope.MapIdentification.MapVersion
            compiler_version: DataMessage.Envelope.MapIdentification.MapVersion
            format: DataMessage.Envelope.MapIdentification.Format
            def __init__(self, provider_version: _Optional[_Union[DataMessage.Envelope.MapIdentification.MapVersion, _Mapping]] = ..., compiler_version: _Optional[_Union[DataMessage.Envelope.MapIdentification.MapVersion, _Mapping]] = ..., format: _Optional[_Union[DataMessage.Envelope.MapIdentification.Format, str]] = ...) -> None: ...
        IDS_FIELD_NUMBER: _ClassVar[int]
        JOB_IDS_FIELD_NUMBER: _ClassVar[int]
        FIELD_RESOLUTION_OVERRIDE_FIELD_NUMBER: _ClassVar[int]
        MAP_IDENTIFICATION_FIELD_NUMBER: _ClassVar[int]
        EXTENSION_FIELD_NUMBER: _ClassVar[int]
        ids: DataMessage.Envelope.Ids
        job_ids: _containers.RepeatedCompositeFieldContainer[_job_pb2.JobIds]
        field_resolution_override: _containers.RepeatedCompositeFieldContainer[DataMessage.Envelope.FieldResolutionOverride]
        map_identification: DataMessage.Envelope.MapIdentification
        extension: _containers.RepeatedCompositeFieldContainer[_any_pb2.Any]
        def __init__(self, ids: _Optional[_Union[DataMessage.Envelope.Ids, _Mapping]] = ..., job_ids: _Optional[_Iterable[_Union[_job_pb2.JobIds, _Mapping]]] = ..., field_resolution_override: _Optional[_Iterable[_Union[DataMessage.Envelope.FieldResolutionOverride, _Mapping]]] = ..., map_identification: _Optional[_Union[DataMessage.Envelope.MapIdentification, _Mapping]] = ..., extension: _Optional[_Iterable[_Union[_any_pb2.Any, _Mapping]]] = ...) -> None: ...
    class EventRelation(_message.Message):
        __slots__ = ("from_id", "type", "to_id", "extension")
        class Type(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
            __slots__ = ()
            UNKNOWN_TYPE: _ClassVar[DataMessage.EventRelation.Type]
            EQUAL: _ClassVar[DataMessage.EventRelation.Type]
            GROUP: _ClassVar[DataMessage.EventRelation.Type]
            CONTAIN: _ClassVar[DataMessage.EventRelation.Type]
            IMPACT: _ClassVar[DataMessage.EventRelation.Type]
            START_AT: _ClassVar[DataMessage.EventRelation.Type]
            END_AT: _ClassVar[DataMessage.EventRelation.Type]
            LEFT_OF: _ClassVar[DataMessage.EventRelation.Type]
            RIGHT_OF: _ClassVar[DataMessage.EventRelation.Type]
            TRIGGERED_BY: _ClassVar[DataMessage.EventRelation.Type]
            DERIVED_FROM: _ClassVar[DataMessage.EventRelation.Type]
            MAP_REFERENCE: _ClassVar[DataMessage.EventRelation.Type]
        UNKNOWN_TYPE: DataMessage.EventRelation.Type
        EQUAL: DataMessage.EventRelation.Type
        GROUP: DataMessage.EventRelation.Type
        CONTAIN: DataMessage.EventRelation.Type
        IMPACT: DataMessage.EventRelation.Type
        START_AT: DataMessage.EventRelation.Type
        END_AT: DataMessage.EventRelation.Type
        LEFT_OF: DataMessage.EventRelation.Type
        RIGHT_OF: DataMessage.EventRelation.Type
        TRIGGERED_BY: DataMessage.EventRelation.Type
        DERIVED_FROM: DataMessage.EventRelation.Type
        MAP_REFERENCE: DataMessage.EventRelation.Type
        FROM_ID_FIELD_NUMBER: _ClassVar[int]
        TYPE_FIELD_NUMBER: _ClassVar[int]
        TO_ID_FIELD_NUMBER: _ClassVar[int]
        EXTENSION_FIELD_NUMBER: _ClassVar[int]
        from_id: _containers.RepeatedCompositeFieldContainer[_wrappers_pb2.Int64Value]
        type: DataMessage.EventRelation.Type
        to_id: _containers.RepeatedCompositeFieldContainer[_wrappers_pb2.Int64Value]
        extension: _containers.RepeatedCompositeFieldContainer[_any_pb2.Any]
        def __init__(self, from_id: _Optional[_Iterable[_Union[_wrappers_pb2.Int64Value, _Mapping]]] = ..., type: _Optional[_Union[DataMessage.EventRelation.Type, str]] = ..., to_id: _Optional[_Iterable[_Union[_wrappers_pb2.Int64Value, _Mapping]]] = ..., extension: _Optional[_Iterable[_Union[_any_pb2.Any, _Mapping]]] = ...) -> None: ...
    class EventSource(_message.Message):
        __slots__ = ("source", "ids", "paths", "extension")
        class EventEnvelopeIds(_message.Message):
            __slots__ = ("id",)
            ID_FIELD_NUMBER: _ClassVar[int]
            id: _containers.RepeatedCompositeFieldContainer[_wrappers_pb2.Int64Value]
            def __init__(self, id: _Optional[_Iterable[_Union[_wrappers_pb2.Int64Value, _Mapping]]] = ...) -> None: ...
        SOURCE_FIELD_NUMBER: _ClassVar[int]
        IDS_FIELD_NUMBER: _ClassVar[int]
        PATHS_FIELD_NUMBER: _ClassVar[int]
        EXTENSION_FIELD_NUMBER: _ClassVar[int]
        source: _source_pb2.Source
        ids: DataMessage.EventSource.EventEnvelopeIds
        paths: DataMessage.Paths
        extension: _containers.RepeatedCompositeFieldContainer[_any_pb2.Any]
        def __init__(self, source: _Optional[_Union[_source_pb2.Source, _Mapping]] = ..., ids: _Optional[_Union[DataMessage.EventSource.EventEnvelopeIds, _Mapping]] = ..., paths: _Optional[_Union[DataMessage.Paths, _Mapping]] = ..., extension: _Optional[_Iterable[_Union[_any_pb2.Any, _Mapping]]] = ...) -> None: ...
    ENVELOPE_FIELD_NUMBER: _ClassVar[int]
    EVENT_GROUP_FIELD_NUMBER: _ClassVar[int]
    EVENT_RELATION_FIELD_NUMBER: _ClassVar[int]
    EVENT_SOURCE_FIELD_NUMBER: _ClassVar[int]
    envelope: DataMessage.Envelope
    event_group: _containers.RepeatedCompositeFieldContainer[EventGroup]
    event_relation: _containers.RepeatedCompositeFieldContainer[DataMessage.EventRelation]
    event_source: _containers.RepeatedCompositeFieldContainer[DataMessage.EventSource]
    def __init__(self, envelope: _Optional[_Union[DataMessage.Envelope, _Mapping]] = ..., event_group: _Optional[_Iterable[_Union[EventGroup, _Mapping]]] = ..., event_relation: _Optional[_Iterable[_Union[DataMessage.EventRelation, _Mapping]]] = ..., event_source: _Optional[_Iterable[_Union[DataMessage.EventSource, _Mapping]]] = ...) -> None: ...

class DataMessages(_message.Message):
    __slots__ = ("envelope", "data_message")
    class Envelope(_message.Message):
        __slots__ = ("version", "submitter", "extension_type_url_and_version", "extension")
        VERSION_FIELD_NUMBER: _ClassVar[int]
        SUBMITTER_FIELD_NUMBER: _ClassVar[int]
        EXTENSION_TYPE_URL_AND_VERSION_FIELD_NUMBER: _ClassVar[int]
        EXTENSION_FIELD_NUMBER: _ClassVar[int]
        version: _base_pb2.Version
        submitter: _containers.RepeatedCompositeFieldContainer[_base_pb2.Entity]
        extension_type_url_and_version: _containers.RepeatedCompositeFieldContainer[_base_pb2.ExtensionTypeUrlAndVersion]
        extension: _containers.RepeatedCompositeFieldContainer[_any_pb2.Any]
        def __init__(self, version: _Optional[_Union[_base_pb2.Version, _Mapping]] = ..., submitter: _Optional[_Iterable[_Union[_base_pb2.Entity, _Mapping]]] = ..., extension_type_url_and_version: _Optional[_Iterable[_Union[_base_pb2.ExtensionTypeUrlAndVersion, _Mapping]]] = ..., extension: _Optional[_Iterable[_Union[_any_pb2.Any, _Mapping]]] = ...) -> None: ...
    ENVELOPE_FIELD_NUMBER: _ClassVar[int]
    DATA_MESSAGE_FIELD_NUMBER: _ClassVar[int]
    envelope: DataMessages.Envelope
    data_message: _containers.RepeatedCompositeFieldContainer[DataMessage]
    def __init__(self, envelope: _Optional[_Union[DataMessages.Envelope, _Mapping]] = ..., data_message: _Optional[_Iterable[_Union[DataMessage, _Mapping]]] = ...) -> None: ...
