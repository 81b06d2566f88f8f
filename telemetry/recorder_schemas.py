"""The recorder's JSON schemas: Foxglove's by their names, and one for each packet, made from the dictionary."""

from typing import Any

import numpy as np

from telemetry.declaration import Packet, Severity
from telemetry.scaling import json_type

POINT_TYPE = np.dtype(
    [(name, "<f4") for name in ("x", "y", "z", "sigma_mm")] + [(name, "<u2") for name in ("panel", "column", "row")]
)
"""One point of /points as bytes."""

_NUMERIC_TYPE = {"<f4": 7, "<u2": 3}  # foxglove.PackedElementField's FLOAT32 and UINT16
POINT_FIELDS = [
    {"name": name, "offset": int(POINT_TYPE.fields[name][1]), "type": _NUMERIC_TYPE[POINT_TYPE[name].str]}
    for name in POINT_TYPE.names or ()
    if POINT_TYPE.fields
]

LOG_LEVEL = {Severity.DIAGNOSTIC: 1, Severity.INFO: 2, Severity.WARNING: 3, Severity.CRITICAL: 5}
"""Severity as foxglove.Log's level."""

_INTEGER, _NUMBER, _STRING = {"type": "integer"}, {"type": "number"}, {"type": "string"}


def _object(title: str, **properties: Any) -> dict[str, Any]:
    return {"title": title, "type": "object", "properties": properties}


_TIME = _object("time", sec=_INTEGER, nsec=_INTEGER)

POINT_CLOUD_SCHEMA = _object(
    "foxglove.PointCloud",
    timestamp=_TIME,
    frame_id=_STRING,
    pose=_object(
        "foxglove.Pose",
        position=_object("foxglove.Vector3", x=_NUMBER, y=_NUMBER, z=_NUMBER),
        orientation=_object("foxglove.Quaternion", x=_NUMBER, y=_NUMBER, z=_NUMBER, w=_NUMBER),
    ),
    point_stride=_INTEGER,
    fields={
        "type": "array",
        "items": _object("foxglove.PackedElementField", name=_STRING, offset=_INTEGER, type=_INTEGER),
    },
    data={"type": "string", "contentEncoding": "base64"},
    tick=_INTEGER,
)

LOG_SCHEMA = _object(
    "foxglove.Log",
    timestamp=_TIME,
    level=_INTEGER,
    message=_STRING,
    name=_STRING,
    file=_STRING,
    line=_INTEGER,
    tick=_INTEGER,
    time_s=_NUMBER,
    event=_INTEGER,
    index=_INTEGER,
    severity=_STRING,
    arguments={"type": "object"},
)


def packet_schema(packet: Packet) -> dict[str, Any]:
    """The JSON schema of a packet's message; no property is required: what is not available is left out."""
    points: dict[str, Any] = {point.name: json_type(point) for point in packet.points}
    title = f"wingbeat.{packet.name.capitalize()}"
    if packet.slots > 1:
        points = {"slots": {"type": "array", "items": _object(f"{title}Slot", slot=_INTEGER, **points)}}
    return _object(title, timestamp=_TIME, tick=_INTEGER, time_s=_NUMBER, **points)
