r"""Messages of MCAP recordings: their protobuf schemas, and their bytes.

The schemas are built here, so that there is no step that generates code, and each file carries
them. The bytes of :obj:`tactile` are those of packed :obj:`float`: viewers see single readings by
their index, and we see one array. :obj:`foxglove.PointCloud` is the
`schema of Foxglove <https://docs.foxglove.dev/docs/sdk/schemas/point-cloud>`_.
"""

import struct
from collections.abc import Iterator, Mapping
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

_INSTALL = "pip install 'torch-geometric-tactile[live]'"
_VARINT, _EIGHT, _TEXT, _FOUR = 0, 1, 2, 5
_ARRAYS: dict[str, np.dtype] = {"double": np.dtype("<f8"), "float": np.dtype("<f4")}
_WIRE = {
    "double": _EIGHT,
    "float": _FOUR,
    "fixed32": _FOUR,
    "int64": _VARINT,
    "int32": _VARINT,
    "uint32": _VARINT,
}
_MOST = 2**28  # bytes of a message


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
# By their numbers, and the types of those that are repeated.
_TABLES: dict[str, tuple[dict[int, tuple[str, Field]], dict[str, np.dtype | None]]] = {
    message: (
        {field.number: (name, field) for name, field in fields.items()},
        {name: _ARRAYS.get(field.kind) for name, field in fields.items() if field.many},
    )
    for message, fields in MESSAGES.items()
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


def encode(message: str, values: Mapping[str, Any]) -> bytes:
    r"""Returns a message in protobuf's format."""
    out = bytearray()
    for name, field in MESSAGES[message].items():
        value = values.get(name)
        if value is None:
            continue
        if not field.many:
            _put(out, field, value)
        elif field.kind in _ARRAYS:
            data = np.asarray(value).astype(_ARRAYS[field.kind], copy=False).tobytes()
            _put_bytes(out, field.number, data)
        elif field.kind in _WIRE:
            packed = b"".join(_varint(int(item)) for item in value)
            _put_bytes(out, field.number, packed)
        else:
            for item in value:
                _put(out, field, item)
    return bytes(out)


def _put(out: bytearray, field: Field, value: Any) -> None:
    if field.kind in MESSAGES:
        _put_bytes(out, field.number, encode(field.kind, value))
    elif field.kind == "string":
        _put_bytes(out, field.number, str(value).encode("utf-8", "replace"))
    elif field.kind == "bytes":
        _put_bytes(out, field.number, value)
    else:
        wire = _WIRE.get(field.kind, _VARINT)
        out += _varint(field.number << 3 | wire)
        if wire == _VARINT:
            out += _varint(int(value))
        else:
            form = {"double": "<d", "float": "<f", "fixed32": "<I"}[field.kind]
            out += struct.pack(form, value)


def _put_bytes(out: bytearray, number: int, data: bytes) -> None:
    out += _varint(number << 3 | _TEXT)
    out += _varint(len(data))
    out += data


def _varint(value: int) -> bytes:
    if value < 0:
        value += 1 << 64
    out = bytearray()
    while value > 0x7F:
        out.append(value & 0x7F | 0x80)
        value >>= 7
    out.append(value)
    return bytes(out)


def decode(message: str, data: bytes | memoryview) -> dict[str, Any]:
    r"""Reads a message: texts, numbers, dictionaries, and arrays of floating-point numbers, which
    share the memory of :obj:`data`. Fields that are not known are passed over.
    """
    known, repeated = _TABLES[message]
    out: dict[str, Any] = {name: [] for name in repeated}
    for number, wire, value in _items(memoryview(data)):
        if number not in known:
            continue
        name, field = known[number]
        if not field.many:
            out[name] = _single(name, field, wire, value)
        elif wire == _TEXT and field.kind in _ARRAYS:
            form = _ARRAYS[field.kind]
            if len(value) % form.itemsize:
                raise ValueError(f"'{name}' must hold numbers of {form.itemsize} bytes")
            out[name].append(np.frombuffer(value, form))
        elif wire == _TEXT and field.kind in _WIRE:
            out[name] += _numbers(value)
        else:
            single = _single(name, field, wire, value)
            is_number = field.kind in _ARRAYS
            out[name].append(np.array([single], _ARRAYS[field.kind]) if is_number else single)
    for name, dtype in repeated.items():
        if dtype is not None:
            parts = out[name]
            out[name] = (
                parts[0] if len(parts) == 1 else np.concatenate([np.zeros(0, dtype), *parts])
            )
    return out


def _single(name: str, field: Field, wire: int, value: Any) -> Any:
    expected = _WIRE.get(field.kind, _VARINT if field.kind == "foxglove.NumericType" else _TEXT)
    if wire != expected:
        raise ValueError(f"'{name}' must be {field.kind} (got wire type {wire})")
    if field.kind in MESSAGES:
        return decode(field.kind, value)
    if field.kind == "string":
        return str(value, "utf-8")
    if wire == _VARINT:
        return value - (1 << 64) if field.kind[0] == "i" and value >> 63 else value
    if wire == _TEXT:
        return value
    return struct.unpack({"double": "<d", "float": "<f", "fixed32": "<I"}[field.kind], value)[0]


def _items(data: memoryview) -> Iterator[tuple[int, int, Any]]:
    place = 0
    while place < len(data):
        tag, place = _read_varint(data, place)
        wire = tag & 7
        if wire == _VARINT:
            value, place = _read_varint(data, place)
            yield tag >> 3, wire, value
            continue
        size = {_EIGHT: 8, _FOUR: 4}.get(wire)
        if wire == _TEXT:
            size, place = _read_varint(data, place)
        if size is None or size > min(len(data) - place, _MOST):
            raise ValueError(f"a field must end inside of its message (got {len(data)} bytes)")
        yield tag >> 3, wire, data[place : place + size]
        place += size


def _numbers(data: memoryview) -> list[int]:
    out, place = [], 0
    while place < len(data):
        value, place = _read_varint(data, place)
        out.append(value)
    return out


def _read_varint(data: memoryview, place: int) -> tuple[int, int]:
    if place < len(data) and data[place] < 0x80:
        return data[place], place + 1
    value = shift = 0
    while place < len(data) and shift < 64:
        byte = data[place]
        value |= (byte & 0x7F) << shift
        place += 1
        if byte < 0x80:
            return value & (1 << 64) - 1, place
        shift += 7
    raise ValueError("a number must end inside of its message (got none)")
