from google.protobuf import any_pb2 as _any_pb2
from google.protobuf import wrappers_pb2 as _wrappers_pb2
from slamcu_core.sensoris.proto import base_pb2 as _base_pb2
from google.protobuf.internal import containers as _containers
from google.protobuf import descriptor as _descriptor
from google.protobuf import message as _message
from collections.abc import Iterable as _Iterable, Mapping as _Mapping
from typing import ClassVar as _ClassVar, Optional as _Optional, Union as _Union

DESCRIPTOR: _descriptor.FileDescriptor

class PositionAndAccuracy(_message.Message):
    __slots__ = ("geographic_wgs84", "metric_vehicle", "metric_event_group", "metric_ecef", "combined_std_dev", "std_dev", "horizontal_confidence_ellipse_vertical_std_dev", "covariance", "extension")
    class Geographic(_message.Message):
        __slots__ = ("longitude", "latitude", "altitude")
        LONGITUDE_FIELD_NUMBER: _ClassVar[int]
        LATITUDE_FIELD_NUMBER: _ClassVar[int]
        ALTITUDE_FIELD_NUMBER: _ClassVar[int]
        longitude: _base_pb2.Int64Value
        latitude: _base_pb2.Int64Value
        altitude: _base_pb2.Int64Value
        def __init__(self, longitude: _Optional[_Union[_base_pb2.Int64Value, _Mapping]] = ..., latitude: _Optional[_Union[_base_pb2.Int64Value, _Mapping]] = ..., altitude: _Optional[_Union[_base_pb2.Int64Value, _Mapping]] = ...) -> None: ...
    class Metric(_message.Message):
        __slots__ = ("x", "y", "z")
        X_FIELD_NUMBER: _ClassVar[int]
        Y_FIELD_NUMBER: _ClassVar[int]
        Z_FIELD_NUMBER: _ClassVar[int]
        x: _base_pb2.Int64Value
        y: _base_pb2.Int64Value
        z: _base_pb2.Int64Value
        def __init__(self, x: _Optional[_Union[_base_pb2.Int64Value, _Mapping]] = ..., y: _Optional[_Union[_base_pb2.Int64Value, _Mapping]] = ..., z: _Optional[_Union[_base_pb2.Int64Value, _Mapping]] = ...) -> None: ...
    class HorizontalVerticalStdDev(_message.Message):
        __slots__ = ("horizontal", "vertical")
        HORIZONTAL_FIELD_NUMBER: _ClassVar[int]
        VERTICAL_FIELD_NUMBER: _ClassVar[int]
        horizontal: _wrappers_pb2.Int64Value
        vertical: _wrappers_pb2.Int64Value
        def __init__(self, horizontal: _Optional[_Union[_wrappers_pb2.Int64Value, _Mapping]] = ..., vertical: _Optional[_Union[_wrappers_pb2.Int64Value, _Mapping]] = ...) -> None: ...
    class HorizontalConfidenceEllipseVerticalStdDev(_message.Message):
        __slots__ = ("horizontal_ellipse_major", "horizontal_ellipse_minor", "horizontal_ellipse_major_heading", "vertical")
        HORIZONTAL_ELLIPSE_MAJOR_FIELD_NUMBER: _ClassVar[int]
        HORIZONTAL_ELLIPSE_MINOR_FIELD_NUMBER: _ClassVar[int]
        HORIZONTAL_ELLIPSE_MAJOR_HEADING_FIELD_NUMBER: _ClassVar[int]
        VERTICAL_FIELD_NUMBER: _ClassVar[int]
        horizontal_ellipse_major: _wrappers_pb2.Int64Value
        horizontal_ellipse_minor: _wrappers_pb2.Int64Value
        horizontal_ellipse_major_heading: _wrappers_pb2.Int64Value
        vertical: _wrappers_pb2.Int64Value
        def __init__(self, horizontal_ellipse_major: _Optional[_Union[_wrappers_pb2.Int64Value, _Mapping]] = ..., horizontal_ellipse_minor: _Optional[_Union[_wrappers_pb2.Int64Value, _Mapping]] = ..., horizontal_ellipse_major_heading: _Optional[_Union[_wrappers_pb2.Int64Value, _Mapping]] = ..., vertical: _Optional[_Union[_wrappers_pb2.Int64Value, _Mapping]] = ...) -> None: ...
    GEOGRAPHIC_WGS84_FIELD_NUMBER: _ClassVar[int]
    METRIC_VEHICLE_FIELD_NUMBER: _ClassVar[int]
    METRIC_EVENT_GROUP_FIELD_NUMBER: _ClassVar[int]
    METRIC_ECEF_FIELD_NUMBER: _ClassVar[int]
    COMBINED_STD_DEV_FIELD_NUMBER: _ClassVar[int]
    STD_DEV_FIELD_NUMBER: _ClassVar[int]
    HORIZONTAL_CONFIDENCE_ELLIPSE_VERTICAL_STD_DEV_FIELD_NUMBER: _ClassVar[int]
    COVARIANCE_FIELD_NUMBER: _ClassVar[int]
    EXTENSION_FIELD_NUMBER: _ClassVar[int]
    geographic_wgs84: PositionAndAccuracy.Geographic
    metric_vehicle: PositionAndAccuracy.Metric
    metric_event_group: PositionAndAccuracy.Metric
    metric_ecef: PositionAndAccuracy.Metric
    combined_std_dev: _wrappers_pb2.Int64Value
    std_dev: PositionAndAccuracy.HorizontalVerticalStdDev
    horizontal_confidence_ellipse_vertical_std_dev: PositionAndAccuracy.HorizontalConfidenceEllipseVerticalStdDev
    covariance: _base_pb2.Int64Matrix3x3
    extension: _containers.RepeatedCompositeFieldContainer[_any_pb2.Any]
    def __init__(self, geographic_wgs84: _Optional[_Union[PositionAndAccuracy.Geographic, _Mapping]] = ..., metric_vehicle: _Optional[_Union[PositionAndAccuracy.Metric, _Mapping]] = ..., metric_event_group: _Optional[_Union[PositionAndAccuracy.Metric, _Mapping]] = ..., metric_ecef: _Optional[_Union[PositionAndAccuracy.Metric, _Mapping]] = ..., combined_std_dev: _Optional[_Union[_wrappers_pb2.Int64Value, _Mapping]] = ..., std_dev: _Optional[_Union[PositionAndAccuracy.HorizontalVerticalStdDev, _Mapping]] = ..., horizontal_confidence_ellipse_vertical_std_dev: _Optional[_Union[PositionAndAccuracy.HorizontalConfidenceEllipseVerticalStdDev, _Mapping]] = ..., covariance: _Optional[_Union[_base_pb2.Int64Matrix3x3, _Mapping]] = ..., extension: _Optional[_Iterable[_Union[_any_pb2.Any, _Mapping]]] = ...) -> None: ...

class XyzVectorAndAccuracy(_message.Message):
    __slots__ = ("metric_vehicle", "metric_event_group", "metric_origin", "combined_std_dev", "std_dev", "covariance", "extension")
    class StdDev(_message.Message):
        __slots__ = ("x", "y", "z")
        X_FIELD_NUMBER: _ClassVar[int]
        Y_FIELD_NUMBER: _ClassVar[int]
        Z_FIELD_NUMBER: _ClassVar[int]
        x: _wrappers_pb2.Int64Value
        y: _wrappers_pb2.Int64Value
        z: _wrappers_pb2.Int64Value
        def __init__(self, x: _Optional[_Union[_wrappers_pb2.Int64Value, _Mapping]] = ..., y: _Optional[_Union[_wrappers_pb2.Int64Value, _Mapping]] = ..., z: _Optional[_Union[_wrappers_pb2.Int64Value, _Mapping]] = ...) -> None: ...
    class Metric(_message.Message):
        __slots__ = ("x", "y", "z")
        X_FIELD_NUMBER: _ClassVar[int]
        Y_FIELD_NUMBER: _ClassVar[int]
        Z_FIELD_NUMBER: _ClassVar[int]
        x: _base_pb2.Int64Value
        y: _base_pb2.Int64Value
        z: _base_pb2.Int64Value
        def __init__(self, x: _Optional[_Union[_base_pb2.Int64Value, _Mapping]] = ..., y: _Optional[_Union[_base_pb2.Int64Value, _Mapping]] = ..., z: _Optional[_Union[_base_pb2.Int64Value, _Mapping]] = ...) -> None: ...
    METRIC_VEHICLE_FIELD_NUMBER: _ClassVar[int]
    METRIC_EVENT_GROUP_FIELD_NUMBER: _ClassVar[int]
    METRIC_ORIGIN_FIELD_NUMBER: _ClassVar[int]
    COMBINED_STD_DEV_FIELD_NUMBER: _ClassVar[int]
    STD_DEV_FIELD_NUMBER: _ClassVar[int]
    COVARIANCE_FIELD_NUMBER: _ClassVar[int]
    EXTENSION_FIELD_NUMBER: _ClassVar[int]
    metric_vehicle: XyzVectorAndAccuracy.Metric
    metric_event_group: XyzVectorAndAccuracy.Metric
    metric_origin: XyzVectorAndAccuracy.Metric
    combined_std_dev: _wrappers_pb2.Int64Value
    std_dev: XyzVectorAndAccuracy.StdDev
    covariance: _base_pb2.Int64Matrix3x3
    extension: _containers.RepeatedCompositeFieldContainer[_any_pb2.Any]
    def __init__(self, metric_vehicle: _Optional[_Union[XyzVectorAndAccuracy.Metric, _Mapping]] = ..., metric_event_group: _Optional[_Union[XyzVectorAndAccuracy.Metric, _Mapping]] = ..., metric_origin: _Optional[_Union[XyzVectorAndAccuracy.Metric, _Mapping]] = ..., combined_std_dev: _Optional[_Union[_wrappers_pb2.Int64Value, _Mapping]] = ..., std_dev: _Optional[_Union[XyzVectorAndAccuracy.StdDev, _Mapping]] = ..., covariance: _Optional[_Union[_base_pb2.Int64Matrix3x3, _Mapping]] = ..., extension: _Optional[_Iterable[_Union[_any_pb2.Any, _Mapping]]] = ...) -> None: ...

class RectangularBoxAndAccuracy(_message.Message):
    __slots__ = ("corner_vectors", "center_orientation_size", "extension")
    class CornerVectors(_message.Message):
        __slots__ = ("first_and_accuracy", "second_and_accuracy", "third_and_accuracy")
        FIRST_AND_ACCURACY_FIELD_NUMBER: _ClassVar[int]
        SECOND_AND_ACCURACY_FIELD_NUMBER: _ClassVar[int]
        THIRD_AND_ACCURACY_FIELD_NUMBER: _ClassVar[int]
        first_and_accuracy: XyzVectorAndAccuracy
        second_and_accuracy: XyzVectorAndAccuracy
        third_and_accuracy: XyzVectorAndAccuracy
        def __init__(self, first_and_accuracy: _Optional[_Union[XyzVectorAndAccuracy, _Mapping]] = ..., second_and_accuracy: _Optional[_Union[XyzVectorAndAccuracy, _Mapping]] = ..., third_and_accuracy: _Optional[_Union[XyzVectorAndAccuracy, _Mapping]] = ...) -> None: ...
    class CenterOrientationSize(_message.Message):
        __slots__ = ("center_position_and_accuracy", "orientation_and_accuracy", "size_and_accuracy")
        CENTER_POSITION_AND_ACCURACY_FIELD_NUMBER: _ClassVar[int]
        ORIENTATION_AND_ACCURACY_FIELD_NUMBER: _ClassVar[int]
        SIZE_AND_ACCURACY_FIELD_NUMBER: _ClassVar[int]
        center_position_and_accuracy: PositionAndAccuracy
        orientation_and_accuracy: RotationAndAccuracy
        size_and_accuracy: XyzVectorAndAccuracy
        def __init__(self, center_position_and_accuracy: _Optional[_Union[PositionAndAccuracy, _Mapping]] = ..., orientation_and_accuracy: _Optional[_Union[RotationAndAccuracy, _Mapping]] = ..., size_and_accuracy: _Optional[_Union[XyzVectorAndAccuracy, _Mapping]] = ...) -> None: ...
    CORNER_VECTORS_FIELD_NUMBER: _ClassVar[int]
    CENTER_ORIENTATION_SIZE_FIELD_NUMBER: _ClassVar[int]
    EXTENSION_FIELD_NUMBER: _ClassVar[int]
    corner_vectors: RectangularBoxAndAccuracy.CornerVectors
    center_orientation_size: RectangularBoxAndAccuracy.CenterOrientationSize
    extension: _containers.RepeatedCompositeFieldContainer[_any_pb2.Any]
    def __init__(self, corner_vectors: _Optional[_Union[RectangularBoxAndAccuracy.CornerVectors, _Mapping]] = ..., center_orientation_size: _Optional[_Union[RectangularBoxAndAccuracy.CenterOrientationSize, _Mapping]] = ..., extension: _Optional[_Iterable[_Union[_any_pb2.Any, _Mapping]]] = ...) -> None: ...

class RotationAndAccuracy(_message.Message):
    __slots__ = ("euler_vehicle", "euler_event_group", "quaternion_vehicle", "quaternion_event_group", "combined_std_dev", "std_dev", "covariance", "extension")
    class Euler(_message.Message):
        __slots__ = ("yaw", "pitch", "roll")
        YAW_FIELD_NUMBER: _ClassVar[int]
        PITCH_FIELD_NUMBER: _ClassVar[int]
        ROLL_FIELD_NUMBER: _ClassVar[int]
        yaw: _base_pb2.Int64Value
        pitch: _base_pb2.Int64Value
        roll: _base_pb2.Int64Value
        def __init__(self, yaw: _Optional[_Union[_base_pb2.Int64Value, _Mapping]] = ..., pitch: _Optional[_Union[_base_pb2.Int64Value, _Mapping]] = ..., roll: _Optional[_Union[_base_pb2.Int64Value, _Mapping]] = ...) -> None: ...
    class Quaternion(_message.Message):
        __slots__ = ("x", "y", "z", "w")
        X_FIELD_NUMBER: _ClassVar[int]
        Y_FIELD_NUMBER: _ClassVar[int]
        Z_FIELD_NUMBER: _ClassVar[int]
        W_FIELD_NUMBER: _ClassVar[int]
        x: _base_pb2.Int64Value
        y: _base_pb2.Int64Value
        z: _base_pb2.Int64Value
        w: _base_pb2.Int64Value
        def __init__(self, x: _Optional[_Union[_base_pb2.Int64Value, _Mapping]] = ..., y: _Optional[_Union[_base_pb2.Int64Value, _Mapping]] = ..., z: _Optional[_Union[_base_pb2.Int64Value, _Mapping]] = ..., w: _Optional[_Union[_base_pb2.Int64Value, _Mapping]] = ...) -> None: ...
    class StdDev(_message.Message):
        __slots__ = ("yaw", "pitch", "roll")
        YAW_FIELD_NUMBER: _ClassVar[int]
        PITCH_FIELD_NUMBER: _ClassVar[int]
        ROLL_FIELD_NUMBER: _ClassVar[int]
        yaw: _wrappers_pb2.Int64Value
        pitch: _wrappers_pb2.Int64Value
        roll: _wrappers_pb2.Int64Value
        def __init__(self, yaw: _Optional[_Union[_wrappers_pb2.Int64Value, _Mapping]] = ..., pitch: _Optional[_Union[_wrappers_pb2.Int64Value, _Mapping]] = ..., roll: _Optional[_Union[_wrappers_pb2.Int64Value, _Mapping]] = ...) -> None: ...
    EULER_VEHICLE_FIELD_NUMBER: _ClassVar[int]
    EULER_EVENT_GROUP_FIELD_NUMBER: _ClassVar[int]
    QUATERNION_VEHICLE_FIELD_NUMBER: _ClassVar[int]
    QUATERNION_EVENT_GROUP_FIELD_NUMBER: _ClassVar[int]
    COMBINED_STD_DEV_FIELD_NUMBER: _ClassVar[int]
    STD_DEV_FIELD_NUMBER: _ClassVar[int]
    COVARIANCE_FIELD_NUMBER: _ClassVar[int]
    EXTENSION_FIELD_NUMBER: _ClassVar[int]
    euler_vehicle: RotationAndAccuracy.Euler
    euler_event_group: RotationAndAccuracy.Euler
    quaternion_vehicle: RotationAndAccuracy.Quaternion
    quaternion_event_group: RotationAndAccuracy.Quaternion
    combined_std_dev: _wrappers_pb2.Int64Value
    std_dev: RotationAndAccuracy.StdDev
    covariance: _base_pb2.Int64Matrix3x3
    extension: _containers.RepeatedCompositeFieldContainer[_any_pb2.Any]
    def __init__(self, euler_vehicle: _Optional[_Union[RotationAndAccuracy.Euler, _Mapping]] = ..., euler_event_group: _Optional[_Union[RotationAndAccuracy.Euler, _Mapping]] = ..., quaternion_vehicle: _Optional[_Union[RotationAndAccuracy.Quaternion, _Mapping]] = ..., quaternion_event_group: _Optional[_Union[RotationAndAccuracy.Quaternion, _Mapping]] = ..., combined_std_dev: _Optional[_Union[_wrappers_pb2.Int64Value, _Mapping]] = ..., std_dev: _Optional[_Union[RotationAndAccuracy.StdDev, _Mapping]] = ..., covariance: _Optional[_Union[_base_pb2.Int64Matrix3x3, _Mapping]] = ..., extension: _Optional[_Iterable[_Union[_any_pb2.Any, _Mapping]]] = ...) -> None: ...

class MapLocationReference(_message.Message):
    __slots__ = ("position_and_accuracy", "z_level", "tile_link_offset_reference", "map_object_id", "extension")
    class TileIdLinkIdOffset(_message.Message):
        __slots__ = ("tile_id", "link_id", "offset", "extension")
        TILE_ID_FIELD_NUMBER: _ClassVar[int]
        LINK_ID_FIELD_NUMBER: _ClassVar[int]
        OFFSET_FIELD_NUMBER: _ClassVar[int]
        EXTENSION_FIELD_NUMBER: _ClassVar[int]
        tile_id: _wrappers_pb2.Int64Value
        link_id: _wrappers_pb2.Int64Value
        offset: _wrappers_pb2.Int64Value
        extension: _containers.RepeatedCompositeFieldContainer[_any_pb2.Any]
        def __init__(self, tile_id: _Optional[_Union[_wrappers_pb2.Int64Value, _Mapping]] = ..., link_id: _Optional[_Union[_wrappers_pb2.Int64Value, _Mapping]] = ..., offset: _Optional[_Union[_wrappers_pb2.Int64Value, _Mapping]] = ..., extension: _Optional[_Iterable[_Union[_any_pb2.Any, _Mapping]]] = ...) -> None: ...
    class TileIdObjectId(_message.Message):
        __slots__ = ("tile_id", "object_id", "extension")
        TILE_ID_FIELD_NUMBER: _ClassVar[int]
        OBJECT_ID_FIELD_NUMBER: _ClassVar[int]
        EXTENSION_FIELD_NUMBER: _ClassVar[int]
        tile_id: _wrappers_pb2.Int64Value
        object_id: _wrappers_pb2.Int64Value
        extension: _containers.RepeatedCompositeFieldContainer[_any_pb2.Any]
        def __init__(self, tile_id: _Optional[_Union[_wrappers_pb2.Int64Value, _Mapping]] = ..., object_id: _Optional[_Union[_wrappers_pb2.Int64Value, _Mapping]] = ..., extension: _Optional[_Iterable[_Union[_any_pb2.Any, _Mapping]]] = ...) -> None: ...
    POSITION_AND_ACCURACY_FIELD_NUMBER: _ClassVar[int]
    Z_LEVEL_FIELD_NUMBER: _ClassVar[int]
    TILE_LINK_OFFSET_REFERENCE_FIELD_NUMBER: _ClassVar[int]
    MAP_OBJECT_ID_FIELD_NUMBER: _ClassVar[int]
    EXTENSION_FIELD_NUMBER: _ClassVar[int]
    position_and_accuracy: PositionAndAccuracy
    z_level: _wrappers_pb2.Int64Value
    tile_link_offset_reference: MapLocationReference.TileIdLinkIdOffset
    map_object_id: MapLocationReference.TileIdObjectId
    extension: _containers.RepeatedCompositeFieldContainer[_any_pb2.Any]
    def __init__(self, position_and_accuracy: _Optional[_Union[PositionAndAccuracy, _Mapping]] = ..., z_level: _Optional[_Union[_wrappers_pb2.Int64Value, _Mapping]] = ..., tile_link_offset_reference: _Optional[_Union[MapLocationReference.TileIdLinkIdOffset, _Mapping]] = ..., map_object_id: _Optional[_Union[MapLocationReference.TileIdObjectId, _Mapping]] = ..., extension: _Optional[_Iterable[_Union[_any_pb2.Any, _Mapping]]] = ...) -> None: ...
