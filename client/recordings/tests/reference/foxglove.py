"""Writes foxglove-protobuf.mcap and foxglove-json.mcap beside this file, with programs that tidemap does not use.

    pip install mcap mcap-protobuf-support foxglove-schemas-protobuf
    python foxglove.py

A robot drives along x from 1 m to 2 m in the second after START. Its sensor is half a metre in front of its body. In the
middle of that second there is a scan with three beams and a cloud with two points and one without a return.
"""

import base64
import json
import math
import struct
from pathlib import Path

from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from foxglove_schemas_protobuf.LaserScan_pb2 import LaserScan
from foxglove_schemas_protobuf.LocationFix_pb2 import LocationFix
from foxglove_schemas_protobuf.Log_pb2 import Log
from foxglove_schemas_protobuf.PointCloud_pb2 import PointCloud
from foxglove_schemas_protobuf.PoseInFrame_pb2 import PoseInFrame
from mcap.writer import CompressionType, Writer
from mcap_protobuf.writer import Writer as ProtobufWriter

START = 1_700_000_000
MIDDLE = START * 10**9 + 500_000_000
POINTS = [(2.0, 0.0, 0.5), (0.0, 0.0, 0.0), (0.0, -1.0, 0.5)]
DATA = b"".join(struct.pack("<fffH", *point, 7) for point in POINTS)
FLOAT32, UINT16 = 7, 3
FIELDS = [("x", 0, FLOAT32), ("y", 4, FLOAT32), ("z", 8, FLOAT32), ("ring", 12, UINT16)]
RANGES = [1.0, 2.0, math.inf]


def protobuf(path):
    def stamped(message, nanos):
        message.timestamp.FromNanoseconds(nanos)
        return message

    with open(path, "wb") as file, ProtobufWriter(file, compression=CompressionType.NONE) as writer:
        write = lambda topic, message, nanos: writer.write_message(topic, message, nanos, nanos)
        first = START * 10**9
        mount = stamped(FrameTransform(parent_frame_id="base", child_frame_id="laser"), first)
        mount.translation.x = 0.5
        write("/mounts", FrameTransforms(transforms=[mount]), first)
        for step in range(2):
            now = first + step * 10**9
            place = stamped(FrameTransform(parent_frame_id="odom", child_frame_id="base"), now)
            place.translation.x = 1.0 + step
            place.rotation.w = 1.0
            write("/place", place, now)
        scan = LaserScan(frame_id="laser", start_angle=-math.pi / 2, end_angle=math.pi / 2, ranges=RANGES)
        write("/scan", stamped(scan, MIDDLE), MIDDLE)
        cloud = PointCloud(frame_id="base", point_stride=14, data=DATA)
        cloud.pose.position.z = 1.0
        for name, offset, kind in FIELDS:
            cloud.fields.add(name=name, offset=offset, type=kind)
        write("/points", stamped(cloud, MIDDLE), MIDDLE)
        pose = PoseInFrame(frame_id="odom")
        pose.pose.position.x = 1.5
        write("/pose", stamped(pose, MIDDLE), MIDDLE)
        write("/fix", stamped(LocationFix(latitude=53.2), MIDDLE), MIDDLE)
        write("/log", stamped(Log(level=Log.Level.ERROR, name="door", message="jammed"), MIDDLE), MIDDLE)


NUMBER, TEXT = {"type": "number"}, {"type": "string"}


def described(**properties):
    return {"type": "object", "properties": properties}


TIME = {"type": "object", "title": "time", "properties": {"sec": {"type": "integer"}, "nsec": {"type": "integer"}}}
VECTOR = described(x=NUMBER, y=NUMBER, z=NUMBER)
POSE = described(position=VECTOR, orientation=described(x=NUMBER, y=NUMBER, z=NUMBER, w=NUMBER))
KIND = {"title": "NumericType", "oneOf": [{"title": "UINT8", "const": 1}, {"title": "FLOAT32", "const": 7}]}
FIELD = described(name=TEXT, offset={"type": "integer"}, type=KIND)
TRANSFORM = described(
    timestamp=TIME, parent_frame_id=TEXT, child_frame_id=TEXT, translation=VECTOR, rotation=POSE["properties"]["orientation"]
)
SCHEMAS = {
    "foxglove.FrameTransforms": described(transforms={"type": "array", "items": TRANSFORM}),
    "foxglove.FrameTransform": TRANSFORM,
    "foxglove.LaserScan": described(
        timestamp=TIME, frame_id=TEXT, pose=POSE, start_angle=NUMBER, end_angle=NUMBER, ranges={"type": "array", "items": NUMBER}
    ),
    "foxglove.PointCloud": described(
        timestamp=TIME,
        frame_id=TEXT,
        pose=POSE,
        point_stride={"type": "integer"},
        fields={"type": "array", "items": FIELD},
        data={"type": "string", "contentEncoding": "base64"},
    ),
    "own.Door": described(open={"type": "boolean"}, grid={"type": "array", "items": {"type": "array", "items": NUMBER}}),
}


def in_json(path):
    with open(path, "wb") as file:
        writer = Writer(file, compression=CompressionType.NONE)
        writer.start()
        schemas = {
            name: writer.register_schema(name, "jsonschema", json.dumps(schema).encode()) for name, schema in SCHEMAS.items()
        }
        channels = {}

        def write(topic, name, message, nanos, encoding="json"):
            if topic not in channels:
                channels[topic] = writer.register_channel(topic, encoding, schemas.get(name, 0))
            data = json.dumps(message).encode()
            writer.add_message(channels[topic], nanos, data, nanos)

        def time(nanos):
            return {"sec": nanos // 10**9, "nsec": nanos % 10**9}

        def transform(parent, child, x, nanos):
            return {
                "timestamp": time(nanos),
                "parent_frame_id": parent,
                "child_frame_id": child,
                "translation": {"x": x, "y": 0, "z": 0},
                "rotation": {"x": 0, "y": 0, "z": 0, "w": 1},
            }

        first = START * 10**9
        write("/mounts", "foxglove.FrameTransforms", {"transforms": [transform("base", "laser", 0.5, first)]}, first)
        for step in range(2):
            now = first + step * 10**9
            write("/place", "foxglove.FrameTransform", transform("odom", "base", 1 + step, now), now)
        pose = {"position": {"x": 0, "y": 0, "z": 0}, "orientation": {"x": 0, "y": 0, "z": 0, "w": 1}}
        # JSON has no infinity.
        ranges = [str(number) if math.isinf(number) else number for number in RANGES]
        scan = {"start_angle": -math.pi / 2, "end_angle": math.pi / 2, "ranges": ranges}
        write("/scan", "foxglove.LaserScan", {"timestamp": time(MIDDLE), "frame_id": "laser", "pose": pose, **scan}, MIDDLE)
        fields = [{"name": name, "offset": offset, "type": kind} for name, offset, kind in FIELDS]
        lifted = {**pose, "position": {"x": 0, "y": 0, "z": 1}}
        cloud = {"point_stride": 14, "fields": fields, "data": base64.b64encode(DATA).decode()}
        write("/points", "foxglove.PointCloud", {"timestamp": time(MIDDLE), "frame_id": "base", "pose": lifted, **cloud}, MIDDLE)
        write("/door", "own.Door", {"open": True, "grid": [[1, 2], [3]]}, MIDDLE)
        write("/door", "own.Door", {"open": "ajar"}, MIDDLE)
        write("/bare", None, {"open": True}, MIDDLE)
        write("/flat", "own.Door", {"open": True}, MIDDLE, "flatbuffer")
        writer.finish()


protobuf(Path(__file__).with_name("foxglove-protobuf.mcap"))
in_json(Path(__file__).with_name("foxglove-json.mcap"))
