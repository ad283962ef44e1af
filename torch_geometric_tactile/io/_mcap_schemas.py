r"""Messages of MCAP recordings: their protobuf schemas, and their bytes.

The schemas are built here, so that there is no step that generates code, and each file carries
them. The bytes of :obj:`tactile` are those of packed :obj:`float`: viewers see single readings by
their index, and we see one array. :obj:`foxglove.PointCloud` is the
`schema of Foxglove <https://docs.foxglove.dev/docs/sdk/schemas/point-cloud>`_.
"""

from collections.abc import Mapping
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
# Kinds of events between which an annotation lies; the text of both is its label.
SPAN_START, SPAN_END = "annotation_start", "annotation_end"

_INSTALL = "pip install 'torch-geometric-tactile[live]'"


class Field(NamedTuple):
    r"""One field of a message; :obj:`many` if it is repeated."""

    number: int
    kind: str
    many: bool = False


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


def schema_of(message: str) -> bytes:
    r"""Returns the schema of a message and of all that it refers to: a serialized
    :obj:`FileDescriptorSet` of protobuf.
    """
    pb = _descriptors()
    out = pb.FileDescriptorSet()
    for name in _needed(message):
        package, _, short = name.rpartition(".")
        file = out.file.add(name=_file_of(name), package=package, syntax="proto3")
        _describe(pb, file.message_type.add(name=short), MESSAGES[name])
        kinds = {field.kind for field in MESSAGES[name].values()}
        file.dependency.extend(_file_of(kind) for kind in sorted(kinds) if kind in MESSAGES)
    return bytes(out.SerializeToString(deterministic=True))


def check_schema(data: bytes) -> str:
    r"""Compares the schema of a file's frames with ours."""
    if data == schema_of(FRAME):
        return ""
    pb = _descriptors()
    theirs = pb.FileDescriptorSet()
    try:
        theirs.ParseFromString(data)
    except Exception as error:  # DecodeError, whose module depends on the version
        return f"it is no schema of protobuf ({error})"
    found = {
        f"{file.package}.{message.name}": {field.name: field for field in message.field}
        for file in theirs.file
        for message in file.message_type
    }
    for message in _needed(FRAME):
        fields = found.get(message, {})
        for name, ours in MESSAGES[message].items():
            field = fields.get(name)
            if field is None and name not in ("time", "tactile", "shape"):
                continue
            kind = "" if field is None else _kind(pb, field)
            if field is None or (field.number, kind) != (ours.number, ours.kind):
                got = "none" if field is None else f"{kind} {field.number}"
                return f"'{message}.{name}' must be {ours.kind} {ours.number} (got {got})"
    return ""


def _descriptors() -> Any:
    try:
        from google.protobuf import descriptor_pb2
    except ImportError as error:
        raise ImportError(f"MCAP recordings need protobuf: {_INSTALL}") from error
    return descriptor_pb2


def _kind(pb: Any, field: Any) -> str:
    name: str = pb.FieldDescriptorProto.Type.Name(field.type)
    # Names that are no UTF-8 are bytes.
    return str(field.type_name).removeprefix(".") or name.removeprefix("TYPE_").lower()


def _file_of(message: str) -> str:
    return f"{message.replace('.', '/')}.proto".replace("Timestamp", "timestamp")


def _needed(message: str) -> list[str]:
    # Those that others refer to first.
    out: list[str] = []
    for field in MESSAGES[message].values():
        if field.kind in MESSAGES:
            out += [name for name in _needed(field.kind) if name not in out]
    return [*out, message]


def _describe(pb: Any, message: Any, fields: Mapping[str, Field]) -> None:
    proto = pb.FieldDescriptorProto
    for name, field in fields.items():
        row = message.field.add(name=name, number=field.number, json_name=name)
        row.label = proto.LABEL_REPEATED if field.many else proto.LABEL_OPTIONAL
        if field.kind in MESSAGES:
            row.type, row.type_name = proto.TYPE_MESSAGE, f".{field.kind}"
        elif field.kind == "foxglove.NumericType":
            row.type = proto.TYPE_ENUM
            row.type_name = ".foxglove.PackedElementField.NumericType"
            enum = message.enum_type.add(name="NumericType")
            for number, value in enumerate(_NUMERIC_TYPE):
                enum.value.add(name=value, number=number)
        else:
            row.type = proto.Type.Value(f"TYPE_{field.kind.upper()}")


@cache
def _type_of(message: str) -> Any:
    # The class that protobuf makes of the fields. They are optional, which tells a zero from
    # nothing and has the same bytes.
    from google.protobuf import descriptor_pool, message_factory

    pb, pool = _descriptors(), descriptor_pool.DescriptorPool()
    for file in pb.FileDescriptorSet.FromString(schema_of(message)).file:
        for made in file.message_type:
            for field in made.field:
                if field.label == field.LABEL_OPTIONAL:
                    field.proto3_optional = True
                    field.oneof_index = len(made.oneof_decl)
                    made.oneof_decl.add(name=f"_{field.name}")
        pool.Add(file)
    return message_factory.GetMessageClass(pool.FindMessageTypeByName(message))


def encode(message: str, values: Mapping[str, Any]) -> bytes:
    r"""Returns a message in protobuf's format. What is None, or no field of it, is left out."""
    known = {name: _plain(values[name]) for name in MESSAGES[message] if name in values}
    return bytes(_type_of(message)(**known).SerializeToString())


def _plain(value: Any) -> Any:
    if isinstance(value, np.ndarray):
        return value.ravel().tolist()
    if isinstance(value, Mapping):
        return {name: _plain(part) for name, part in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(part) for part in value]
    return value.encode("utf-8", "replace").decode() if isinstance(value, str) else value


def decode(message: str, data: bytes | memoryview) -> Any:
    r"""Reads a message, as protobuf's own object. Fields that are not known are passed over."""
    try:
        return _type_of(message).FromString(bytes(data))
    except Exception as error:  # DecodeError, whose module depends on the version
        raise ValueError(f"a message must be a {message} of protobuf ({error})") from error
