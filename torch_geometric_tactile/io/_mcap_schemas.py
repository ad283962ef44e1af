r"""Protobuf schemas of the messages in MCAP recordings, and encoding and decoding of the messages.

The schemas are built in Python, without generated code, and each file contains them. The bytes of
:obj:`tactile` are packed :obj:`float`, so that viewers can show single readings by index and this
package can read one array. :obj:`foxglove.PointCloud` is the
`schema of Foxglove <https://docs.foxglove.dev/docs/sdk/schemas/point-cloud>`_.
"""

from collections.abc import Collection, Mapping
from functools import cache
from typing import Any, NamedTuple

import numpy as np

FRAME, PREDICTION, HEALTH, EVENT = (
    "tactile.Frame",
    "tactile.Prediction",
    "tactile.Health",
    "tactile.Event",
)
POINTS = "foxglove.PointCloud"
TOPICS = (FRAME, PREDICTION, HEALTH, EVENT, POINTS)
# Events at the start and the end of an annotation; the text of both is its label.
SPAN_START, SPAN_END = "annotation_start", "annotation_end"

_INSTALL = "pip install 'torch-geometric-tactile[live]'"


class Field(NamedTuple):
    r"""A field of a message. It is a list if :obj:`is_repeated`."""

    number: int
    kind: str
    is_repeated: bool = False


def _fields(*rows: tuple[str, str]) -> dict[str, Field]:
    return {
        name: Field(number, kind.removesuffix("*"), kind.endswith("*"))
        for number, (name, kind) in enumerate(rows, start=1)
    }


MESSAGES: dict[str, dict[str, Field]] = {
    "tactile.Signal": _fields(
        ("name", "string"), ("dtype", "string"), ("shape", "uint32*"), ("data", "bytes")
    ),
    FRAME: _fields(
        ("sequence", "int64"),
        ("time", "double"),
        ("received", "int64"),
        ("device_time", "double"),
        ("shape", "uint32*"),
        ("tactile", "float*"),
        ("joint", "float*"),
        ("extra", "tactile.Signal*"),
        ("privileged", "tactile.Signal*"),
        ("action", "float*"),
    ),
    PREDICTION: _fields(
        ("time", "double"),
        ("sequence", "int64"),
        ("task", "string"),
        ("class_names", "string*"),
        ("probability", "double*"),
        ("label", "string"),
        ("latency", "double"),
    ),
    HEALTH: _fields(
        ("time", "double"),
        ("state", "string"),
        ("frames", "int64"),
        ("rate", "double"),
        ("jitter", "double"),
        ("lost", "int64"),
        ("corrupt", "int64"),
        ("skipped", "int64"),
        ("dropped", "int64"),
        ("repeated", "int64"),
        ("reconnects", "int64"),
        ("stale_taxels", "int64"),
        ("age", "double"),
        ("checksum", "string"),
        ("outages", "int64"),
        ("outage_seconds", "double"),
    ),
    EVENT: _fields(("time", "double"), ("kind", "string"), ("text", "string")),
    "google.protobuf.Timestamp": _fields(("seconds", "int64"), ("nanos", "int32")),
    "foxglove.Vector3": _fields(("x", "double"), ("y", "double"), ("z", "double")),
    "foxglove.Quaternion": _fields(
        ("x", "double"), ("y", "double"), ("z", "double"), ("w", "double")
    ),
    "foxglove.Pose": _fields(
        ("position", "foxglove.Vector3"), ("orientation", "foxglove.Quaternion")
    ),
    "foxglove.PackedElementField": _fields(
        ("name", "string"), ("offset", "fixed32"), ("type", "foxglove.NumericType")
    ),
    POINTS: _fields(
        ("timestamp", "google.protobuf.Timestamp"),
        ("frame_id", "string"),
        ("pose", "foxglove.Pose"),
        ("point_stride", "fixed32"),
        ("fields", "foxglove.PackedElementField*"),
        ("data", "bytes"),
    ),
}
_NUMERIC_TYPE = (
    *("UNKNOWN", "UINT8", "INT8", "UINT16", "INT16", "UINT32", "INT32", "FLOAT32", "FLOAT64"),
)
FLOAT32 = _NUMERIC_TYPE.index("FLOAT32")


def frame_schema(has_actions: bool) -> bytes:
    r"""Returns the schema of frames in a file. Without actions, it equals the schema of earlier
    versions.
    """
    return message_schema(FRAME, () if has_actions else ("action",))


def message_schema(message: str, without: Collection[str] = ()) -> bytes:
    r"""Returns the schema of a message and of its parts as a serialized protobuf
    :obj:`FileDescriptorSet`, leaving out the fields in :obj:`without`.
    """
    pb = _import_descriptors()
    descriptors = pb.FileDescriptorSet()
    for name in _required_messages(message):
        package, _, message_name = name.rpartition(".")
        file = descriptors.file.add(name=_proto_file(name), package=package, syntax="proto3")
        fields = {
            key: field
            for key, field in MESSAGES[name].items()
            if name != message or key not in without
        }
        _add_fields(pb, file.message_type.add(name=message_name), fields)
        kinds = {field.kind for field in fields.values()}
        file.dependency.extend(_proto_file(kind) for kind in sorted(kinds) if kind in MESSAGES)
    return bytes(descriptors.SerializeToString(deterministic=True))


def schema_problem(data: bytes) -> str:
    r"""Returns the first conflict between the schema in a file and the schema of frames in this
    package, or an empty string.
    """
    if data in (frame_schema(False), frame_schema(True)):
        return ""
    pb = _import_descriptors()
    file_schema = pb.FileDescriptorSet()
    try:
        file_schema.ParseFromString(data)
    except Exception as error:  # DecodeError, whose module depends on the version
        return f"it is not a protobuf schema ({error})"
    file_messages = {
        f"{file.package}.{message.name}": {field.name: field for field in message.field}
        for file in file_schema.file
        for message in file.message_type
    }
    for message in _required_messages(FRAME):
        fields = file_messages.get(message, {})
        for name, expected in MESSAGES[message].items():
            field = fields.get(name)
            if field is None and name not in ("time", "tactile", "shape"):
                continue
            kind = "" if field is None else _type_name(pb, field)
            if field is None or (field.number, kind) != (expected.number, expected.kind):
                actual = "none" if field is None else f"{kind} {field.number}"
                return (
                    f"'{message}.{name}' must be {expected.kind} {expected.number} (got {actual})"
                )
    return ""


def _import_descriptors() -> Any:
    try:
        from google.protobuf import descriptor_pb2
    except ImportError as error:
        raise ImportError(f"MCAP recordings need protobuf: {_INSTALL}") from error
    return descriptor_pb2


def _type_name(pb: Any, field: Any) -> str:
    name: str = pb.FieldDescriptorProto.Type.Name(field.type)
    # A type name that is not valid UTF-8 is returned as bytes.
    return str(field.type_name).removeprefix(".") or name.removeprefix("TYPE_").lower()


def _proto_file(message: str) -> str:
    return f"{message.replace('.', '/')}.proto".replace("Timestamp", "timestamp")


def _required_messages(message: str) -> list[str]:
    # In order of dependency: a message comes after the messages of its fields.
    messages: list[str] = []
    for field in MESSAGES[message].values():
        if field.kind in MESSAGES:
            messages += [name for name in _required_messages(field.kind) if name not in messages]
    return [*messages, message]


def _add_fields(pb: Any, message: Any, fields: Mapping[str, Field]) -> None:
    field_types = pb.FieldDescriptorProto
    for name, field in fields.items():
        descriptor = message.field.add(name=name, number=field.number, json_name=name)
        descriptor.label = (
            field_types.LABEL_REPEATED if field.is_repeated else field_types.LABEL_OPTIONAL
        )
        if field.kind in MESSAGES:
            descriptor.type, descriptor.type_name = field_types.TYPE_MESSAGE, f".{field.kind}"
        elif field.kind == "foxglove.NumericType":
            descriptor.type = field_types.TYPE_ENUM
            descriptor.type_name = ".foxglove.PackedElementField.NumericType"
            enum = message.enum_type.add(name="NumericType")
            for number, value in enumerate(_NUMERIC_TYPE):
                enum.value.add(name=value, number=number)
        else:
            descriptor.type = field_types.Type.Value(f"TYPE_{field.kind.upper()}")


@cache
def _message_class(message: str) -> Any:
    # The class that protobuf creates for a message. Its fields are optional, which distinguishes
    # zero from a missing value, with the same encoding.
    from google.protobuf import descriptor_pool, message_factory

    pb, pool = _import_descriptors(), descriptor_pool.DescriptorPool()
    for file in pb.FileDescriptorSet.FromString(message_schema(message)).file:
        for descriptor in file.message_type:
            for field in descriptor.field:
                if field.label == field.LABEL_OPTIONAL:
                    field.proto3_optional = True
                    field.oneof_index = len(descriptor.oneof_decl)
                    descriptor.oneof_decl.add(name=f"_{field.name}")
        pool.Add(file)
    return message_factory.GetMessageClass(pool.FindMessageTypeByName(message))


def encode(message: str, values: Mapping[str, Any]) -> bytes:
    r"""Encodes a message with protobuf. Values that are :obj:`None` or not fields are left out."""
    field_values = {
        name: _to_plain_value(values[name]) for name in MESSAGES[message] if name in values
    }
    return bytes(_message_class(message)(**field_values).SerializeToString())


def _to_plain_value(value: Any) -> Any:
    if isinstance(value, np.ndarray):
        return value.ravel().tolist()
    if isinstance(value, Mapping):
        return {name: _to_plain_value(part) for name, part in value.items()}
    if isinstance(value, list | tuple):
        return [_to_plain_value(part) for part in value]
    return value.encode("utf-8", "replace").decode() if isinstance(value, str) else value


def decode(message: str, data: bytes | memoryview) -> Any:
    r"""Decodes a message to a protobuf object. Unknown fields are ignored."""
    try:
        return _message_class(message).FromString(bytes(data))
    except Exception as error:  # DecodeError, whose module depends on the version
        raise ValueError(f"a message must be a {message} of protobuf ({error})") from error
